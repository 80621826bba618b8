// Processes of the service killed and stopped at bad moments.
#include <gtest/gtest.h>
#include <signal.h>

#include <chrono>
#include <fstream>
#include <set>
#include <thread>

#include "common/base/clock.h"
#include "common/base/rng.h"
#include "tests/support/service/processes.h"

namespace rg::testing {
namespace {

constexpr double kPatience = 60.0;

void SleepMs(int ms) { std::this_thread::sleep_for(std::chrono::milliseconds(ms)); }

std::vector<std::string> ReadLines(const std::string& path) {
  std::vector<std::string> lines;
  std::ifstream file(path);
  for (std::string line; std::getline(file, line);) lines.push_back(line);
  return lines;
}

pb::JobState WaitForEnd(Service& service, int64_t job) {
  const auto end = service.client().WaitForJob(job, kPatience);
  EXPECT_TRUE(end.ok()) << end.status().ToString() << service.Logs();
  return end.ok() ? end->job().state() : pb::JOB_STATE_UNSPECIFIED;
}

TEST(WorkerKill, ItsTaskFinishesElsewhereWithinTwoHeartbeats) {
  Service service;
  service.StartWorker("a");
  pb::JobSpec job;
  AddTask(&job, "t", "sleep", R"({"seconds": 1.0})");
  const auto id = service.client().Submit(job);
  ASSERT_TRUE(service.WaitForTask(*id, "t", pb::TASK_STATE_LEASED));
  service.StartWorker("b");
  ASSERT_TRUE(service.WaitForWorkers(2));
  service.worker("a").KillNow();
  ASSERT_EQ(WaitForEnd(service, *id), pb::JOB_STATE_SUCCEEDED);
  const auto reply = service.client().GetJob(*id, true, true);
  const auto& attempts = FindTask(*reply, "t")->attempt_list();
  ASSERT_EQ(attempts.size(), 2);
  EXPECT_EQ(attempts[0].outcome(), pb::ATTEMPT_OUTCOME_LOST);
  EXPECT_EQ(attempts[0].worker(), "a");
  EXPECT_EQ(attempts[1].worker(), "b");
  EXPECT_EQ(service.Counter("workers_lost_total"), 1.0);
}

TEST(WorkerKill, ACheckpointGoesOnOnAnotherWorker) {
  Service service;
  service.StartWorker("a");
  pb::JobSpec job;
  AddTask(&job, "t", "count", R"({"to": 40, "step_seconds": 0.05})");
  const auto id = service.client().Submit(job);
  ASSERT_TRUE(service.WaitForTask(*id, "t", pb::TASK_STATE_LEASED));
  SleepMs(1000);
  service.worker("a").KillNow();
  service.StartWorker("b");
  ASSERT_EQ(WaitForEnd(service, *id), pb::JOB_STATE_SUCCEEDED);
  const auto reply = service.client().GetJob(*id);
  const std::string result = *service.client().GetArtifact(FindTask(*reply, "t")->outputs(0).sha256());
  EXPECT_EQ(result.find("\"began_at\":0"), std::string::npos) << result;
  EXPECT_NE(result.find("\"ended_at\":40"), std::string::npos) << result;
}

TEST(WorkerKill, ATaskThatLeadsOthersIsTakenUpWithWhatTheyHaveDone) {
  Service service;
  service.StartWorker("a");
  pb::JobSpec job;
  AddTask(&job, "lead", "lead", R"({"parts": 3, "seconds": 0.3})");
  const auto id = service.client().Submit(job);
  ASSERT_TRUE(service.WaitForProgress(*id, "lead"));
  pb::ListJobsRequest of_it;
  of_it.set_parent_job(*id);
  const auto parts = service.client().ListJobs(of_it);
  ASSERT_TRUE(parts.ok()) << parts.status().ToString();
  ASSERT_EQ(parts->size(), 1u);
  EXPECT_EQ(parts->front().parent_job(), *id);
  EXPECT_EQ(parts->front().submitted_by(), "task lead of job " + std::to_string(*id));
  // The only slot is taken by the one who leads: its parts are for another worker.
  service.StartWorker("b");
  ASSERT_TRUE(service.WaitForTask(parts->front().id(), "part0", pb::TASK_STATE_SUCCEEDED));
  service.worker("a").KillNow();
  service.StartWorker("c");
  ASSERT_EQ(WaitForEnd(service, *id), pb::JOB_STATE_SUCCEEDED);
  const auto reply = service.client().GetJob(*id, true, true);
  const pb::TaskInfo* lead = FindTask(*reply, "lead");
  EXPECT_EQ(lead->attempts(), 2u);
  EXPECT_EQ(*service.client().GetArtifact(lead->outputs(0).sha256()), "part0 slept;part1 slept;part2 slept;");
  EXPECT_EQ(service.client().ListJobs(of_it)->size(), 1u) << "the second attempt found the first one's job";
  const auto done = service.client().GetJob(parts->front().id());
  EXPECT_EQ(done->job().state(), pb::JOB_STATE_SUCCEEDED);
  EXPECT_EQ(FindTask(*done, "part0")->attempts(), 1u) << "what was done is not done again";
}

TEST(WorkerKill, ACoordinatorKilledMeanwhileKeepsWhatATaskHasSubmitted) {
  Service service;
  service.StartWorker("a", 2);
  pb::JobSpec job;
  AddTask(&job, "lead", "lead", R"({"parts": 4, "seconds": 0.3})");
  const auto id = service.client().Submit(job);
  ASSERT_TRUE(service.WaitForProgress(*id, "lead"));
  service.KillCoordinator();
  service.StartCoordinator();
  ASSERT_EQ(WaitForEnd(service, *id), pb::JOB_STATE_SUCCEEDED);
  pb::ListJobsRequest of_it;
  of_it.set_parent_job(*id);
  const auto parts = service.client().ListJobs(of_it);
  ASSERT_EQ(parts->size(), 1u);
  EXPECT_EQ(parts->front().state(), pb::JOB_STATE_SUCCEEDED);
}

// A job of two tasks with a time limit that runs out while the coordinator is away.
class LimitPassedMeanwhile : public ::testing::Test {
 protected:
  static constexpr int kHeartbeatMs = 1000;  // at its second one after the restart a worker must know
  static constexpr double kLimit = 2.0;
  LimitPassedMeanwhile() {
    service_.StartWorker("a");
    pb::JobSpec job;
    AddTask(&job, "first", "sleep", R"({"seconds": 600, "until": ")" + go() + "\"}");
    AddInput(AddTask(&job, "second", "echo"), "in", "first");
    job.set_time_limit_s(kLimit);
    const double begin = RealClock().SteadySeconds();
    id_ = *service_.client().Submit(job);
    EXPECT_TRUE(service_.WaitForProgress(id_, "first")) << service_.Logs();
    service_.KillCoordinator();
    while (RealClock().SteadySeconds() < begin + kLimit + 0.5) SleepMs(20);
  }
  std::string go() const { return service_.folder() + "/go"; }

  Service service_{kHeartbeatMs};
  int64_t id_ = 0;
};

TEST_F(LimitPassedMeanwhile, WhatWasFinishedCountsAndTheRestIsDoneByARetry) {
  std::ofstream(go()) << "\n";
  SleepMs(500);
  service_.StartCoordinator();
  ASSERT_EQ(WaitForEnd(service_, id_), pb::JOB_STATE_FAILED);
  const auto ended = service_.client().GetJob(id_);
  EXPECT_EQ(ended->job().reason(), "its time limit of 2 s is over");
  EXPECT_EQ(FindTask(*ended, "first")->state(), pb::TASK_STATE_SUCCEEDED) << service_.Logs();
  EXPECT_EQ(FindTask(*ended, "second")->attempts(), 0u) << "nothing begins after the limit";
  ASSERT_TRUE(service_.client().Act(id_, pb::JOB_ACTION_RETRY).ok());
  ASSERT_EQ(WaitForEnd(service_, id_), pb::JOB_STATE_SUCCEEDED);
  EXPECT_EQ(FindTask(*service_.client().GetJob(id_), "first")->attempts(), 1u);
}

TEST_F(LimitPassedMeanwhile, WhatStillRunsIsStopped) {
  service_.StartCoordinator();
  ASSERT_EQ(WaitForEnd(service_, id_), pb::JOB_STATE_FAILED);
  const auto ended = service_.client().GetJob(id_);
  EXPECT_EQ(ended->job().reason(), "its time limit of 2 s is over");
  EXPECT_EQ(FindTask(*ended, "first")->state(), pb::TASK_STATE_CANCELLED);
  pb::JobSpec quick;
  AddTask(&quick, "t", "echo");
  EXPECT_EQ(WaitForEnd(service_, *service_.client().Submit(quick)), pb::JOB_STATE_SUCCEEDED) << "its slot is free";
}

TEST(WorkerStop, ALateResultIsRefusedAndCounted) {
  Service service;
  service.StartWorker("a");
  pb::JobSpec job;
  AddTask(&job, "t", "sleep", R"({"seconds": 0.5})");
  const auto id = service.client().Submit(job);
  ASSERT_TRUE(service.WaitForTask(*id, "t", pb::TASK_STATE_LEASED));
  SleepMs(100);
  service.worker("a").Signal(SIGSTOP);  // its executor goes on and finishes
  service.StartWorker("b");
  ASSERT_EQ(WaitForEnd(service, *id), pb::JOB_STATE_SUCCEEDED);
  service.worker("a").Signal(SIGCONT);
  ASSERT_TRUE(service.WaitForWorkers(2)) << "a stopped worker joins again by itself";
  const double end = RealClock().SteadySeconds() + 20.0;
  while (service.Counter("results_refused_total") < 1.0 && RealClock().SteadySeconds() < end) SleepMs(20);
  EXPECT_GE(service.Counter("results_refused_total"), 1.0) << service.Logs();
  const auto reply = service.client().GetJob(*id, true, true);
  EXPECT_EQ(FindTask(*reply, "t")->attempt_list(1).outcome(), pb::ATTEMPT_OUTCOME_SUCCEEDED);
  pb::JobSpec after;
  for (int i = 0; i < 4; ++i) AddTask(&after, "t" + std::to_string(i), "sleep", R"({"seconds": 0.1})");
  const auto next = service.client().Submit(after);
  EXPECT_EQ(WaitForEnd(service, *next), pb::JOB_STATE_SUCCEEDED);
}

TEST(AtMostOnce, ALostRolloutIsNotRunAgainWithoutConsent) {
  Service service;
  service.StartAgent("a");
  const std::string path = service.folder() + "/runs";
  pb::JobSpec job;
  AddTask(&job, "t", "rollout", R"({"seconds": 30, "path": ")" + path + "\"}");
  const auto id = service.client().Submit(job);
  const double end = RealClock().SteadySeconds() + 20.0;
  while (ReadLines(path).empty() && RealClock().SteadySeconds() < end) SleepMs(10);
  ASSERT_EQ(ReadLines(path).size(), 1u);
  service.worker("a").KillNow();
  service.StartAgent("b");
  ASSERT_TRUE(service.WaitForTask(*id, "t", pb::TASK_STATE_UNCERTAIN));
  EXPECT_NE(service.client().Explain(*id)->reasons(0).find("may have run on a"), std::string::npos);
  ASSERT_EQ(WaitForEnd(service, *id), pb::JOB_STATE_FAILED);
  EXPECT_EQ(ReadLines(path).size(), 1u);
  ASSERT_TRUE(service.client().Act(*id, pb::JOB_ACTION_RETRY).ok());
  while (ReadLines(path).size() < 2 && RealClock().SteadySeconds() < end + 20.0) SleepMs(10);
  EXPECT_EQ(ReadLines(path).size(), 2u) << "with consent it runs";
}

TEST(AtMostOnce, ACoordinatorKilledMeanwhileChangesNothing) {
  Service service;
  service.StartAgent("a");
  const std::string path = service.folder() + "/runs";
  pb::JobSpec job;
  AddTask(&job, "t", "rollout", R"({"seconds": 1.5, "path": ")" + path + "\"}");
  const auto id = service.client().Submit(job);
  const double end = RealClock().SteadySeconds() + 20.0;
  while (ReadLines(path).empty() && RealClock().SteadySeconds() < end) SleepMs(10);
  service.KillCoordinator();
  SleepMs(200);
  service.StartCoordinator();
  ASSERT_EQ(WaitForEnd(service, *id), pb::JOB_STATE_SUCCEEDED);
  EXPECT_EQ(ReadLines(path).size(), 1u);
}

TEST(CoordinatorKill, ARunningTaskKeepsItsLeaseOverTheRestart) {
  Service service;
  service.StartWorker("a");
  pb::JobSpec job;
  AddTask(&job, "t", "sleep", R"({"seconds": 1.5})");
  const auto id = service.client().Submit(job);
  ASSERT_TRUE(service.WaitForTask(*id, "t", pb::TASK_STATE_LEASED));
  SleepMs(300);
  service.KillCoordinator();
  SleepMs(300);
  service.StartCoordinator();
  ASSERT_EQ(WaitForEnd(service, *id), pb::JOB_STATE_SUCCEEDED);
  const auto reply = service.client().GetJob(*id, true, true);
  EXPECT_EQ(FindTask(*reply, "t")->attempts(), 1u) << service.Logs();
}

// kill -9 again and again while jobs are submitted and run: what was acknowledged is there and ends,
// every task has one committed result, and its output is what it should be.
TEST(CoordinatorKill, NothingIsLostOrCommittedTwiceAtRandomTimes) {
  Service service;
  service.StartWorker("a", 2);
  service.StartWorker("b", 2);
  Rng rng(11);
  std::vector<int64_t> jobs;
  std::set<int64_t> distinct;
  constexpr int kRounds = 12;
  for (int round = 0; round < kRounds; ++round) {
    pb::JobSpec job;
    for (int i = 0; i < 6; ++i) {
      AddTask(&job, "t" + std::to_string(i), "echo",
              "{\"text\": \"" + std::to_string(round * 10 + i) + ";\"}")
          ->set_stage("s");
    }
    AddStageInput(AddTask(&job, "join", "echo"), "all", "s");
    std::thread killer([&] {
      SleepMs(static_cast<int>(rng.Index(60)));
      service.KillCoordinator();
      service.StartCoordinator();
    });
    const auto id = service.client().Submit(job, "round" + std::to_string(round));
    killer.join();
    ASSERT_TRUE(id.ok()) << id.status().ToString() << service.Logs();
    jobs.push_back(*id);
    distinct.insert(*id);
  }
  EXPECT_EQ(distinct.size(), jobs.size());
  EXPECT_EQ(service.client().ListJobs()->size(), jobs.size()) << "no submit made two jobs";
  for (int round = 0; round < kRounds; ++round) {
    const int64_t id = jobs[static_cast<size_t>(round)];
    ASSERT_EQ(WaitForEnd(service, id), pb::JOB_STATE_SUCCEEDED) << service.Logs();
    const auto reply = service.client().GetJob(id, true, true);
    for (const pb::TaskInfo& task : reply->tasks()) {
      int succeeded = 0;
      for (const auto& attempt : task.attempt_list())
        succeeded += attempt.outcome() == pb::ATTEMPT_OUTCOME_SUCCEEDED;
      EXPECT_EQ(succeeded, 1) << task.name();
      EXPECT_EQ(task.outputs_size(), 1);
    }
    std::string expected;
    for (int i = 0; i < 6; ++i) expected += std::to_string(round * 10 + i) + ";";
    EXPECT_EQ(*service.client().GetArtifact(FindTask(*reply, "join")->outputs(0).sha256()), expected);
  }
  const auto damage = service.client().VerifyArtifacts();
  ASSERT_TRUE(damage.ok());
  EXPECT_EQ(damage->damaged_size(), 0);
}

}  // namespace
}  // namespace rg::testing
