// A worker that is in trouble itself: it can start no executor, may not join, hears of no coordinator. Tasks pay for none
// of it, and a rollout under way is not broken off.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/mount.h>
#include <sys/resource.h>
#include <unistd.h>

#include <filesystem>
#include <thread>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "tests/support/service/processes.h"
#include "worker/worker.h"

namespace rg::testing {
namespace {

using ::testing::HasSubstr;

constexpr double kPatience = 120.0;

bool Within(double seconds, const std::function<bool()>& is_so) {
  const double until = RealClock().SteadySeconds() + seconds;
  while (!is_so()) {
    if (RealClock().SteadySeconds() > until) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  return true;
}

// How many files the process may have open; what it has stays open.
void LimitFiles(pid_t pid, rlim_t most) {
  rlimit limit{};
  ASSERT_EQ(prlimit(pid, RLIMIT_NOFILE, nullptr, &limit), 0);
  limit.rlim_cur = std::min(most, limit.rlim_max);
  ASSERT_EQ(prlimit(pid, RLIMIT_NOFILE, &limit, nullptr), 0);
}
rlim_t FirstFreeFile(pid_t pid) {
  rlim_t file = 0;
  while (std::filesystem::is_symlink("/proc/" + std::to_string(pid) + "/fd/" + std::to_string(file))) ++file;
  return file;
}

pb::WorkerInfo Listed(Service& service, const std::string& name) {
  const auto workers = service.client().Workers();
  if (!workers.ok()) return {};
  for (const pb::WorkerInfo& worker : *workers)
    if (worker.name() == name) return worker;
  return {};
}
std::string UnableOf(Service& service, const std::string& name) { return Listed(service, name).unable(); }

int64_t SubmitOnce(Service& service) {
  pb::JobSpec job;
  AddTask(&job, "t", "echo", R"({"text": "done"})")->set_max_attempts(1);
  return service.client().Submit(job).value();
}

TEST(WorkerTrouble, AWorkerThatCanStartNoExecutorCostsNoAttemptAndIsGivenNothingUntilItCan) {
  Service service;
  const pid_t pid = service.StartWorker("a").pid();
  ASSERT_TRUE(service.WaitForWorkers(1));
  LimitFiles(pid, FirstFreeFile(pid));
  const int64_t first = SubmitOnce(service);
  ASSERT_TRUE(Within(kPatience, [&] { return !UnableOf(service, "a").empty(); })) << service.Logs();
  EXPECT_THAT(UnableOf(service, "a"), HasSubstr("executor"));

  service.StartWorker("b");
  const auto end = service.client().WaitForJob(first, kPatience);
  ASSERT_TRUE(end.ok()) << end.status().ToString();
  EXPECT_EQ(end->job().state(), pb::JOB_STATE_SUCCEEDED) << end->job().reason() << service.Logs();
  const auto reply = service.client().GetJob(first, true, true);
  for (const auto& attempt : FindTask(*reply, "t")->attempt_list())
    EXPECT_EQ(attempt.outcome() == pb::ATTEMPT_OUTCOME_SUCCEEDED, attempt.worker() == "b") << attempt.error();

  service.worker("b").KillNow();
  LimitFiles(pid, RLIM_INFINITY);
  const int64_t second = SubmitOnce(service);
  const auto later = service.client().WaitForJob(second, kPatience);
  ASSERT_TRUE(later.ok()) << later.status().ToString() << service.Logs();
  EXPECT_EQ(later->job().state(), pb::JOB_STATE_SUCCEEDED) << later->job().reason();
}

TEST(WorkerTrouble, AWorkerThatCanStartNoFurtherExecutorGoesOnWithThoseItHas) {
  Service service;
  const pid_t pid = service.StartWorker("a", 2).pid();
  const std::string until = service.folder() + "/until";
  pb::JobSpec job;
  AddTask(&job, "t", "sleep", R"({"seconds": 600, "until": ")" + until + "\"}");
  const int64_t first = service.client().Submit(job).value();
  ASSERT_TRUE(service.WaitForProgress(first, "t")) << service.Logs();
  LimitFiles(pid, FirstFreeFile(pid));
  const int64_t second = SubmitOnce(service);
  ASSERT_TRUE(Within(kPatience, [&] { return Listed(service, "a").slots() == 1; })) << service.Logs();
  EXPECT_EQ(UnableOf(service, "a"), "");
  ASSERT_TRUE(WriteFileAtomically(until, "").ok());
  for (const int64_t id : {first, second}) {
    const auto end = service.client().WaitForJob(id, kPatience);
    ASSERT_TRUE(end.ok()) << end.status().ToString() << service.Logs();
    EXPECT_EQ(end->job().state(), pb::JOB_STATE_SUCCEEDED) << end->job().reason() << service.Logs();
  }
}

TEST(WorkerTrouble, AWorkerWhoseExecutorsNeverComeUpLeavesAndTheTaskWaitsForAnother) {
  Service service;
  worker::WorkerOptions options;
  options.coordinator = service.endpoint();
  options.name = "a";
  options.slots = 1;
  options.kinds = {"echo"};
  options.folder = service.folder() + "/worker-a";
  options.executor_rest_s = 0.01;
  options.executor_arguments = {"this_test", "--gtest_filter=None"};  // ends at once
  auto worker = worker::Worker::Open(options, &RealClock());
  ASSERT_TRUE(worker.ok()) << worker.status().ToString();
  const int64_t job = SubmitOnce(service);
  const Status left = (*worker)->Run(-1);
  EXPECT_EQ(left.code(), StatusCode::kUnavailable);
  EXPECT_THAT(left.message(), HasSubstr("no executor comes up: its executor ended with exit code 0"));
  EXPECT_THAT(left.message(), HasSubstr("8 times in a row"));

  service.StartWorker("b");
  const auto end = service.client().WaitForJob(job, kPatience);
  ASSERT_TRUE(end.ok()) << end.status().ToString();
  EXPECT_EQ(end->job().state(), pb::JOB_STATE_SUCCEEDED) << end->job().reason() << service.Logs();
}

// A disk of some MiB, with a worker's folder.
class SmallDisk {
 public:
  explicit SmallDisk(std::string folder) : folder_(std::move(folder)) {
    std::filesystem::create_directories(folder_);
    is_mounted_ = ::mount("tmpfs", folder_.c_str(), "tmpfs", 0, "size=16m") == 0;
  }
  ~SmallDisk() {
    if (is_mounted_) ::umount2(folder_.c_str(), MNT_DETACH);
  }
  bool is_mounted() const { return is_mounted_; }
  const std::string& folder() const { return folder_; }

 private:
  std::string folder_;
  bool is_mounted_ = false;
};

TEST(WorkerTrouble, AWorkerWithAFullDiskIsUnableIsGivenNothingAndComesBackByItself) {
  Service service(4'000);  // a worker that is lost meanwhile, on a busy machine, would be given the task as it comes back
  const SmallDisk disk(service.folder() + "/worker-a");
  if (!disk.is_mounted()) GTEST_SKIP() << "cannot mount a small disk here";
  service.StartWorker("a");
  ASSERT_TRUE(service.WaitForWorkers(1)) << service.Logs();
  ASSERT_TRUE(WriteFileAtomically(disk.folder() + "/filler", std::string(15'800'000, 'x')).ok());
  ASSERT_TRUE(Within(kPatience, [&] { return !UnableOf(service, "a").empty(); })) << service.Logs();
  EXPECT_THAT(UnableOf(service, "a"), HasSubstr("has a full disk"));
  EXPECT_THAT(UnableOf(service, "a"), HasSubstr(disk.folder()));
  const int64_t job = SubmitOnce(service);
  const auto why = service.client().Explain(job, "");
  ASSERT_TRUE(why.ok());
  EXPECT_THAT(why->reasons(0), HasSubstr("has a full disk"));
  const auto listed = service.client().ListJobs();
  ASSERT_TRUE(listed.ok());
  EXPECT_THAT(listed->front().reason(), HasSubstr("a: has a full disk"));
  std::filesystem::remove(disk.folder() + "/filler");
  const auto end = service.client().WaitForJob(job, kPatience);
  ASSERT_TRUE(end.ok()) << end.status().ToString() << service.Logs();
  EXPECT_EQ(end->job().state(), pb::JOB_STATE_SUCCEEDED) << end->job().reason();
  EXPECT_EQ(end->job().reason(), "");
  EXPECT_EQ(FindTask(*service.client().GetJob(job, true, true), "t")->attempts(), 1u);
}

TEST(WorkerTrouble, ATaskThatADiskHasNoRoomForCostsNoAttemptAndGoesToAnotherWorker) {
  Service service(4'000);
  const SmallDisk disk(service.folder() + "/worker-a");
  if (!disk.is_mounted()) GTEST_SKIP() << "cannot mount a small disk here";
  service.StartWorker("a");
  ASSERT_TRUE(service.WaitForWorkers(1)) << service.Logs();
  pb::JobSpec spec;
  AddTask(&spec, "t", "blob", R"({"bytes": 20000000})")->set_max_attempts(1);
  const int64_t job = service.client().Submit(spec).value();
  ASSERT_TRUE(Within(kPatience, [&] { return !UnableOf(service, "a").empty(); })) << service.Logs();
  service.StartWorker("b");
  const auto end = service.client().WaitForJob(job, kPatience);
  ASSERT_TRUE(end.ok()) << end.status().ToString() << service.Logs();
  EXPECT_EQ(end->job().state(), pb::JOB_STATE_SUCCEEDED) << end->job().reason();
  const auto reply = service.client().GetJob(job, true, true);
  EXPECT_EQ(FindTask(*reply, "t")->attempt_list(0).worker(), "a");
  EXPECT_THAT(FindTask(*reply, "t")->attempt_list(0).error(), HasSubstr("No space left on device"));
}

class ARolloutUnderWay : public ::testing::Test {
 protected:
  void Begin(double seconds, const std::vector<std::string>& flags = {}) {
    service_.StartAgent("a", flags);
    pb::JobSpec job;
    AddTask(&job, "t", "rollout",
            R"({"seconds": )" + std::to_string(seconds) + R"(, "line": "begun", "last_line": "ended", "path": ")" +
                path_ + "\"}");
    ASSERT_TRUE(service_.client().Submit(job).ok());
    ASSERT_TRUE(Within(kPatience, [&] { return Lines() == "begun\n"; })) << service_.Logs();
  }
  static std::string TextOf(const std::string& path) {
    const auto text = ReadFile(path);
    return text.ok() ? *text : "";
  }
  std::string Lines() const { return TextOf(path_); }
  std::string Log() const { return TextOf(service_.folder() + "/a.log"); }

  Service service_{400, {"--uncertain-s", "600"}};  // nobody takes it back meanwhile
  const std::string path_ = service_.folder() + "/lines";
};

TEST_F(ARolloutUnderWay, IsNotBrokenOffWhereNobodyIsHeardOfTheCoordinator) {
  Begin(2.0, {"--patience", "0.5"});
  service_.KillCoordinator();
  constexpr int kExitUnreachable = 6;
  EXPECT_EQ(service_.worker("a").WaitForExit(kPatience), kExitUnreachable) << Log();
  EXPECT_EQ(Lines(), "begun\nended\n") << Log();
  EXPECT_THAT(Log(), HasSubstr("no word from the coordinator"));
}

// Another process has taken the name while this one was not heard of.
TEST_F(ARolloutUnderWay, IsNotBrokenOffByARefusal) {
  Begin(4.0);
  service_.KillCoordinator();
  service_.worker("a").Signal(SIGSTOP);
  Process other({BinFolder() + "/synthetic_worker", "--coordinator", service_.endpoint(), "--name", "a", "--folder",
                 service_.folder() + "/other", "--robot", "one"},
                service_.folder() + "/other.log");
  service_.StartCoordinator();
  ASSERT_TRUE(service_.WaitForWorkers(1)) << service_.Logs();
  service_.worker("a").Signal(SIGCONT);
  EXPECT_EQ(service_.worker("a").WaitForExit(kPatience), 1) << Log();
  EXPECT_EQ(Lines(), "begun\nended\n") << Log();
  EXPECT_THAT(Log(), HasSubstr("is taken by a process that is at work"));
}

}  // namespace
}  // namespace rg::testing
