// kill -9 of coordinator, worker or agent while an iteration of a small robot runs: trajectories, policy,
// rollout and identification by the real programs. Every job ends, what it planned and learnt is what an
// undisturbed one does to the bit, nothing is committed twice, and no rollout runs again without consent. In
// batches, each a service of its own under its own seed.
//
// RG_ITERATION_CYCLES says how many kills (the suite `full`: 1,000). With RG_PROGRESS=FILE batches that are
// done are noted there, and a run that was broken off goes on with the next.
#include <gtest/gtest.h>

#include <chrono>
#include <cstdlib>
#include <map>
#include <set>
#include <thread>

#include "common/base/clock.h"
#include "common/base/rng.h"
#include "common/store/database.h"
#include "tests/integration/cli/small_robot.h"
#include "tests/support/base/batches_done.h"
#include "tests/support/service/cuts.h"
#include "tests/support/service/processes.h"

namespace rg::testing {
namespace {

constexpr double kPatience = 600.0;
constexpr int kCyclesPerBatch = 20;
constexpr uint64_t kLongestPauseMs = 1'500;
const char kIteration[] =
    "submit iteration --robot ./small.robot.json --model nominal --trajectories 8 --shard-size 2 --epochs 3 "
    "--aggregations 0 --examination 0 --rollout-seconds 2 --identify-seconds 0 --hops 1 --rounds 2 --chains "
    "2 "
    "--output quiet";

void SleepMs(uint64_t ms) { std::this_thread::sleep_for(std::chrono::milliseconds(ms)); }

// What an iteration planned and learnt before there was a rollout, by task and output.
using Made = std::map<std::string, std::string>;

class Laboratory {
 public:
  Laboratory() {
    WriteSmallRobot(scratch_, nlohmann::json::array(), 0.1);
    for (const char* name : {"a", "b", "agent"}) StartProgram(name);
    EXPECT_TRUE(service_.WaitForWorkers(3)) << Logs();
  }
  void StartProgram(const std::string& name) {
    std::vector<std::string> arguments = {"--coordinator", service_.endpoint(), "--name", name,
                                          "--folder",      scratch_ / name};
    if (name == "agent") {
      for (const std::string& more :
           {std::string("--config"), scratch_ / "small_agent.json", std::string("--spool"),
            scratch_ / "spool", std::string("--lock-step"), std::string("--trusted")})
        arguments.push_back(more);
    } else {
      arguments.insert(arguments.end(), {"--slots", "1"});
    }
    arguments.insert(arguments.begin(),
                     BinFolder() + (name == "agent" ? "/realitygrad-agent" : "/realitygrad-worker"));
    programs_[name] = std::make_unique<Process>(arguments, scratch_ / (name + ".log"));
  }
  void Kill(const std::string& name) { programs_.at(name)->KillNow(); }
  // As a service manager does: an agent that was started while what is left of the killed one still ends a
  // rollout finds its spool taken, and leaves.
  void Supervise() {
    for (const char* name : {"a", "b", "agent"}) {
      if (programs_.at(name)->WaitForExit(0.0) >= 0) StartProgram(name);
    }
  }
  // At a named point of its file work it may be killed before it listens.
  void StartCoordinator(const std::string& point) {
    const UnderShim shim(database(), point, false);
    point.empty() ? service_.StartCoordinator() : (void)service_.TryStartCoordinator();
  }

  int64_t Submit() {
    const Said said = RunProgram(scratch_, "--coordinator " + service_.endpoint() + " " + kIteration);
    EXPECT_EQ(said.code, 0) << said.err << Logs();
    return std::atoll(said.out.c_str());
  }
  Made MadeBy(const pb::GetJobReply& job) {
    Made made;
    for (const pb::TaskInfo& task : job.tasks()) {
      for (const pb::TaskOutput& output : task.outputs()) {
        if (output.kind() == "trajectories" || output.kind() == "policy")
          made[task.name() + "/" + output.name()] = output.sha256();
      }
    }
    return made;
  }

  Service& service() { return service_; }
  std::string database() const { return service_.folder() + "/service.db"; }
  std::string Logs() const {
    std::string text = service_.Logs();
    for (const auto& [name, program] : programs_) {
      const auto log = ReadFile(scratch_ / (name + ".log"));
      if (log.ok())
        text += "--- " + name + "\n" + log->substr(log->size() - std::min<size_t>(log->size(), 2'000));
    }
    return text;
  }

 private:
  const ScratchFolder scratch_;
  Service service_{300};
  std::map<std::string, std::unique_ptr<Process>> programs_;
};

// What nobody disturbed makes; once per process.
const Made& Undisturbed() {
  static const Made made = [] {
    Laboratory laboratory;
    const int64_t job = laboratory.Submit();
    const auto end = laboratory.service().client().WaitForJob(job, kPatience);
    EXPECT_TRUE(end.ok()) << end.status().ToString() << laboratory.Logs();
    const auto reply = laboratory.service().client().GetJob(job, true, true);
    EXPECT_EQ(reply->job().state(), pb::JOB_STATE_SUCCEEDED) << reply->job().reason() << laboratory.Logs();
    return laboratory.MadeBy(*reply);
  }();
  return made;
}

class Batch {
 public:
  explicit Batch(uint64_t seed) : rng_(seed) { jobs_.push_back(laboratory_.Submit()); }

  void Run(int cycles) {
    for (int cycle = 0; cycle < cycles && !::testing::Test::HasFailure(); ++cycle) {
      SleepMs(rng_.Index(kLongestPauseMs));
      KeepAJobRunning();
      if (!::testing::Test::HasFailure()) KillOne();
    }
    for (const int64_t job : jobs_) {
      if (!::testing::Test::HasFailure()) AwaitSuccess(job);
    }
    if (!::testing::Test::HasFailure()) CheckAll();
  }
  std::map<std::string, int> kills() const { return kills_; }
  int jobs() const { return static_cast<int>(jobs_.size()); }
  int consents() const { return consents_of_all_; }

 private:
  coordinator::Client& client() { return laboratory_.service().client(); }

  // Each in turn: two workers, the agent, the coordinator at a named point of its file work and twice as it
  // comes.
  void KillOne() {
    if (victims_.empty()) {
      victims_ = {0, 1, 2, 3, 4, 5};
      for (size_t i = victims_.size(); i > 1; --i) std::swap(victims_[i - 1], victims_[rng_.Index(i)]);
    }
    const int kind = victims_.back();
    victims_.pop_back();
    if (kind < 3) {
      const std::string name = kind == 0 ? "a" : kind == 1 ? "b" : "agent";
      ++kills_[kind == 2 ? "agent" : "worker"];
      laboratory_.Kill(name);
      laboratory_.StartProgram(name);
      return;
    }
    ++kills_["coordinator"];
    laboratory_.service().KillCoordinator();
    if (kind == 3) {
      ++kills_["at named points"];
      laboratory_.StartCoordinator((rng_.Index(2) == 0 ? "before_sync:" : "after_sync:") +
                                   std::to_string(1 + rng_.Index(20)));
      constexpr double kWork = 2.0;  // unless it comes to the point before
      laboratory_.service().coordinator().WaitForExit(kWork);
      laboratory_.service().KillCoordinator();
    }
    if (rng_.Index(4) == 0) SleepMs(rng_.Index(kLongestPauseMs));  // away for longer than a lease
    laboratory_.StartCoordinator("");
  }

  void KeepAJobRunning() {
    laboratory_.Supervise();
    const auto reply = client().GetJob(jobs_.back());
    ASSERT_TRUE(reply.ok()) << "an acknowledged job is gone: " << reply.status().ToString()
                            << laboratory_.Logs();
    if (reply->job().state() == pb::JOB_STATE_SUCCEEDED) jobs_.push_back(laboratory_.Submit());
    if (reply->job().state() == pb::JOB_STATE_FAILED) Consent(*reply);
  }
  // A rollout whose agent was killed did not begin, or may have moved the robot, or left too few rows, and a
  // task whose worker was lost again and again is set aside: a person says that they may run again. Nothing
  // else may fail.
  void Consent(const pb::GetJobReply& job) {
    const std::string& reason = job.job().reason();
    const bool of_a_kill = reason.find("`retry` lets it run again") != std::string::npos ||
                           reason.find("stopped before the rollout began") != std::string::npos ||
                           reason.find("the process that recorded it ended") != std::string::npos ||
                           reason.find("its worker was lost") != std::string::npos;
    ASSERT_TRUE(of_a_kill) << reason << laboratory_.Logs();
    ++consents_[job.job().id()], ++consents_of_all_;
    const auto acted = client().Act(job.job().id(), pb::JOB_ACTION_RETRY);
    ASSERT_TRUE(acted.ok()) << acted.status().ToString();
  }
  void AwaitSuccess(int64_t job) {
    const double until = RealClock().SteadySeconds() + kPatience;
    while (!::testing::Test::HasFailure() && RealClock().SteadySeconds() < until) {
      laboratory_.Supervise();
      constexpr double kLook = 1.0;
      const auto end = client().WaitForJob(job, kLook);
      if (!end.ok() && end.status().code() == StatusCode::kDeadlineExceeded) continue;
      ASSERT_TRUE(end.ok()) << end.status().ToString() << laboratory_.Logs();
      if (end->job().state() == pb::JOB_STATE_SUCCEEDED) return;
      ASSERT_EQ(end->job().state(), pb::JOB_STATE_FAILED) << laboratory_.Logs();
      Consent(*client().GetJob(job));
    }
    FAIL() << "job " << job << " does not end" << laboratory_.Logs();
  }

  void CheckAll() {
    for (const int64_t job : jobs_) CheckJob(job);
    EXPECT_EQ(client().ListAllJobs()->size(), jobs_.size()) << "no submit made two jobs";
    const auto damage = client().VerifyArtifacts();
    ASSERT_TRUE(damage.ok()) << damage.status().ToString();
    EXPECT_EQ(damage->damaged_size(), 0);
    laboratory_.service().KillCoordinator();
    const auto file = store::Database::Open({.path = laboratory_.database()}, {});
    ASSERT_TRUE(file.ok()) << file.status().ToString();
    EXPECT_TRUE((*file)->CheckIntegrity().ok());
    CheckRollouts(**file);
  }
  // How often a rollout was allowed to begin is in the file alone.
  void CheckRollouts(store::Database& file) {
    auto begun = file.Prepare("SELECT task, COUNT(*) FROM attempts WHERE granted_ns != 0 GROUP BY task");
    ASSERT_TRUE(begun.ok()) << begun.status().ToString();
    int rollouts = 0;
    for (; *begun->Step(); ++rollouts) {
      constexpr int kTaskIndexBits = 24;
      const int64_t job = begun->Int(0) >> kTaskIndexBits;
      EXPECT_LE(begun->Int(1), 1 + consents_[job])
          << "the rollout of job " << job << " ran again without consent";
    }
    EXPECT_EQ(rollouts, static_cast<int>(jobs_.size()));
  }
  void CheckJob(int64_t id) {
    const auto reply = client().GetJob(id, true, true);
    ASSERT_TRUE(reply.ok()) << reply.status().ToString();
    EXPECT_EQ(laboratory_.MadeBy(*reply), Undisturbed()) << "job " << id;
    for (const pb::TaskInfo& task : reply->tasks()) {
      int succeeded = 0;
      for (const auto& attempt : task.attempt_list())
        succeeded += attempt.outcome() == pb::ATTEMPT_OUTCOME_SUCCEEDED;
      EXPECT_EQ(succeeded, 1) << "job " << id << " task " << task.name();
    }
  }

  Rng rng_;
  Laboratory laboratory_;
  std::vector<int64_t> jobs_;
  std::vector<int> victims_;
  std::map<int64_t, int> consents_;
  std::map<std::string, int> kills_;
  int consents_of_all_ = 0;
};

TEST(IterationCycles, NothingAcknowledgedIsLostOrCommittedTwiceAndResultsAreThoseOfAnUndisturbedRun) {
  RG_NEEDS_PRELOADING();
  ASSERT_GE(Undisturbed().size(), 5u) << "four shards and a policy";
  BatchesDone done("iterations");
  std::map<std::string, int> kills;
  int batch = 0, jobs = 0, consents = 0, played = 0;
  for (int left = CountAsked("RG_ITERATION_CYCLES", 6); left > 0; left -= kCyclesPerBatch, ++batch) {
    if (done.Find(batch)) continue;
    Batch one(7'000 + static_cast<uint64_t>(batch));
    one.Run(std::min(left, kCyclesPerBatch));
    if (HasFailure()) return;
    for (const auto& [what, count] : one.kills()) kills[what] += count;
    jobs += one.jobs(), consents += one.consents(), played += std::min(left, kCyclesPerBatch);
    done.Note(batch);
  }
  done.Forget();
  std::printf(
      "%d kills (coordinator %d, of them %d at named points, workers %d, agent %d), %d iterations, %d "
      "consents\n",
      played, kills["coordinator"], kills["at named points"], kills["worker"], kills["agent"], jobs,
      consents);
}

}  // namespace
}  // namespace rg::testing
