// A worker and an agent that outlive the coordinator's database: a new one, a restored backup, two in turn. Numbers of jobs
// and tokens begin again there, and what is of one database never counts in another.
#include <gtest/gtest.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <thread>

#include "common/base/clock.h"
#include "common/store/restore.h"
#include "tests/support/service/server_bench.h"

namespace rg::testing {
namespace {

constexpr double kPatience = 60.0;

class AnotherDatabase : public ::testing::Test {
 protected:
  void MoveTo(const std::string& name) {
    service_.KillCoordinator();
    service_.UseDatabase(name);
    service_.StartCoordinator();
  }
  int64_t Submit(const std::string& task, const std::string& kind, const std::string& payload) {
    pb::JobSpec job;
    AddTask(&job, task, kind, payload);
    const auto id = client().Submit(job);
    EXPECT_TRUE(id.ok()) << id.status().ToString();
    return id.ok() ? *id : 0;
  }
  // What the job's only task came to.
  std::string ResultOf(int64_t job) {
    const auto end = client().WaitForJob(job, kPatience);
    EXPECT_TRUE(end.ok()) << end.status().ToString() << service_.Logs();
    const auto reply = client().GetJob(job, true, true);
    if (!reply.ok() || reply->tasks_size() != 1 || reply->tasks(0).outputs_size() != 1)
      return reply.ok() ? reply->job().reason() : reply.status().ToString();
    return client().GetArtifact(reply->tasks(0).outputs(0).sha256()).value();
  }
  std::string Echo(const std::string& text) { return ResultOf(Submit("t", "echo", R"({"text": ")" + text + "\"}")); }
  int64_t SubmitWait(const std::string& task) {
    const int64_t job = Submit(task, "sleep", R"({"seconds": 600, "until": ")" + Flag(task) + "\"}");
    EXPECT_TRUE(service_.WaitForProgress(job, task, kPatience)) << service_.Logs();
    return job;
  }
  void EndWait(const std::string& task) { std::ofstream(Flag(task)) << "now"; }
  int64_t SubmitRollout(const std::string& line, const std::string& more = "") {
    return Submit("r", "rollout", R"({"path": ")" + Runs() + R"(", "line": ")" + line + "\"" + more + "}");
  }
  std::string Runs() const { return service_.folder() + "/runs"; }
  std::string AllRuns() const {
    std::string all;
    std::ifstream file(Runs());
    for (std::string line; std::getline(file, line);) all += line + ";";
    return all;
  }
  coordinator::Client& client() { return service_.client(); }

  Service service_;

 private:
  std::string Flag(const std::string& task) const { return service_.folder() + "/" + task + ".flag"; }
};

TEST_F(AnotherDatabase, ANewOneGetsItsTasksDone) {
  service_.StartWorker("a");
  service_.StartAgent("agent");
  for (int token = 1; token <= 12; ++token) EXPECT_EQ(Echo("old"), "old");  // more than a task may be lost
  EXPECT_EQ(ResultOf(SubmitRollout("old")), "old\n");
  const std::string before = client().CoordinatorStatus()->database_identity();
  MoveTo("new.db");
  EXPECT_NE(client().CoordinatorStatus()->database_identity(), before);
  EXPECT_EQ(Echo("new 1"), "new 1");
  EXPECT_EQ(ResultOf(SubmitRollout("new")), "new\n");
  EXPECT_EQ(Echo("new 3"), "new 3");
  EXPECT_EQ(AllRuns(), "old;new;");
  EXPECT_EQ(service_.Counter("attempts_lost_total"), 0.0) << service_.Logs();
}

TEST_F(AnotherDatabase, ARestoredBackupIsOne) {
  service_.StartWorker("a");
  service_.StartAgent("agent");
  EXPECT_EQ(Echo("before"), "before");
  const std::string before = client().CoordinatorStatus()->database_identity();
  const auto backup = client().Backup("backup.db");
  ASSERT_TRUE(backup.ok()) << backup.status().ToString();
  EXPECT_EQ(Echo("lost"), "lost");
  EXPECT_EQ(ResultOf(SubmitRollout("lost")), "lost\n");
  for (const char* turn : {"once", "twice"}) {
    service_.KillCoordinator();
    std::filesystem::remove_all(service_.database() + ".before-restore");
    ASSERT_TRUE(store::RestoreDatabase({backup->path(), service_.database(), true}, {}).ok()) << turn;
    service_.StartCoordinator();
    EXPECT_NE(client().CoordinatorStatus()->database_identity(), before);
    EXPECT_EQ(ResultOf(1), "before");
    const int64_t second = Submit("t", "echo", std::string(R"({"text": ")") + turn + "\"}");
    EXPECT_EQ(second, 2) << "numbers are given again";
    EXPECT_EQ(ResultOf(second), turn);
    EXPECT_EQ(ResultOf(SubmitRollout(turn)), std::string(turn) + "\n");
  }
  EXPECT_EQ(AllRuns(), "lost;once;twice;");
}

// The tokens are the same on both sides: 1, then 2.
TEST_F(AnotherDatabase, OfTwoInTurnNeitherTakesWhatRunsForTheOther) {
  service_.StartWorker("a");
  ASSERT_TRUE(service_.WaitForWorkers(1));
  const int64_t first = SubmitWait("of-first");
  MoveTo("second.db");
  EXPECT_EQ(Echo("second"), "second");
  const int64_t second = SubmitWait("of-second");
  MoveTo("service.db");
  ASSERT_TRUE(service_.WaitForProgress(first, "of-first", kPatience)) << service_.Logs();
  EndWait("of-second");
  EndWait("of-first");
  EXPECT_EQ(ResultOf(first), "of-first slept");
  MoveTo("second.db");
  EXPECT_EQ(ResultOf(second), "of-second slept");
  EXPECT_EQ(Echo("after all"), "after all");
}

TEST_F(AnotherDatabase, ARolloutUnderWayEndsBeforeTheNextOneBeginsAndItsJobAsks) {
  service_.StartAgent("agent");
  const int64_t first = SubmitRollout("first", R"(, "seconds": 600)");
  const double until = RealClock().SteadySeconds() + kPatience;
  while (AllRuns().empty() && RealClock().SteadySeconds() < until)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  MoveTo("second.db");
  EXPECT_EQ(ResultOf(SubmitRollout("second")), "second\n");
  MoveTo("service.db");
  EXPECT_NE(ResultOf(first).find("may have run on agent"), std::string::npos);
  EXPECT_EQ(AllRuns(), "first;second;");
  ASSERT_TRUE(client().Act(first, pb::JOB_ACTION_RETRY).ok());
  ASSERT_TRUE(service_.WaitForTask(first, "r", pb::TASK_STATE_LEASED, kPatience));
  while (AllRuns() == "first;second;" && RealClock().SteadySeconds() < until)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  EXPECT_EQ(AllRuns(), "first;second;first;") << "with consent it runs";
}

// A lease of the same number may be the same worker's, of before.
TEST(AnotherDatabasesWorker, IsToldSoAndNotHeard) {
  ServerBench bench;
  const auto client = bench.Connect("client", pb::ROLE_OPERATOR), worker = bench.Connect("w1", pb::ROLE_WORKER);
  client->Submit(OneTask(), "r1");
  worker->Hello({"echo"});
  ASSERT_TRUE(bench.Turn().ok());
  const auto mail = worker->Mail();
  ASSERT_TRUE(mail.front().has_welcome());
  const std::string identity = mail.front().welcome().database();
  EXPECT_EQ(identity.size(), 32u);
  EXPECT_EQ(AssignmentIn(mail).database(), identity);

  pb::WorkerMessage hello;
  hello.mutable_hello()->set_name("w");
  for (pb::WorkerMessage message : {FinishedMessage(AssignmentIn(mail)), hello}) {
    message.set_database("of another");
    worker->Tell(message);
    ASSERT_TRUE(bench.Turn().ok());
    const auto answer = worker->Mail();
    ASSERT_EQ(answer.size(), 1u);
    EXPECT_EQ(answer[0].another_database(), identity);
    EXPECT_EQ(bench.state().leases.size(), 1u) << "its lease is untouched";
  }
  pb::WorkerMessage finished = FinishedMessage(AssignmentIn(mail));
  finished.set_database(identity);
  worker->Tell(finished);
  ASSERT_TRUE(bench.Turn().ok());
  EXPECT_TRUE(worker->Mail().front().result_reply().accepted());
}

}  // namespace
}  // namespace rg::testing
