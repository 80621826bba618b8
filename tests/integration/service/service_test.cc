// The service over real sockets with a real database and real processes.
#include <gtest/gtest.h>
#include <signal.h>

#include <chrono>
#include <filesystem>
#include <thread>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/hash.h"
#include "common/store/artifact_store.h"
#include "common/store/database.h"
#include "tests/support/service/processes.h"

namespace rg::testing {
namespace {

constexpr double kPatience = 40.0;

pb::GetJobReply RunJob(Service& service, const pb::JobSpec& job) {
  const auto id = service.client().Submit(job);
  EXPECT_TRUE(id.ok()) << id.status().ToString();
  if (!id.ok()) return {};
  const auto end = service.client().WaitForJob(*id, kPatience);
  EXPECT_TRUE(end.ok()) << end.status().ToString() << service.Logs();
  const auto full = service.client().GetJob(*id, true, true);
  EXPECT_TRUE(full.ok()) << full.status().ToString();
  return full.ok() ? *full : pb::GetJobReply();
}

TEST(Service, RunsAGraphAndKeepsItsOutputsWithTheirLineage) {
  Service service;
  service.StartWorker("a", 2);
  pb::JobSpec job;
  job.set_kind("test");
  for (int i = 0; i < 3; ++i) {
    AddTask(&job, "shard" + std::to_string(i), "echo", R"({"text": "s)" + std::to_string(i) + R"(;"})")
        ->set_stage("shards");
  }
  AddStageInput(AddTask(&job, "join", "echo", R"({"text": "all:"})"), "shards", "shards");
  const auto reply = RunJob(service, job);
  ASSERT_EQ(reply.job().state(), pb::JOB_STATE_SUCCEEDED) << reply.job().reason() << service.Logs();
  EXPECT_EQ(reply.job().tasks_done(), 4u);
  EXPECT_DOUBLE_EQ(reply.job().progress(), 1.0);
  const pb::TaskInfo* join = FindTask(reply, "join");
  ASSERT_EQ(join->outputs_size(), 1);
  const auto bytes = service.client().GetArtifact(join->outputs(0).sha256());
  ASSERT_TRUE(bytes.ok()) << bytes.status().ToString();
  EXPECT_EQ(*bytes, "all:s0;s1;s2;");  // in the order of the graph
  const auto lineage = service.client().Lineage(join->outputs(0).sha256());
  ASSERT_TRUE(lineage.ok());
  EXPECT_EQ(lineage->nodes_size(), 4);
  EXPECT_EQ(lineage->edges_size(), 3);
  ASSERT_EQ(reply.stages_size(), 2);
  EXPECT_EQ(reply.stages(0).done(), 3u);
}

TEST(Service, WhatATaskSubmitsIsOverWhenTheTaskIs) {
  Service service;
  service.StartWorker("a", 2);
  pb::JobSpec job;
  AddTask(&job, "lead", "lead", R"({"parts": 2, "seconds": 60, "leave": true})");
  const auto reply = RunJob(service, job);
  ASSERT_EQ(reply.job().state(), pb::JOB_STATE_SUCCEEDED) << reply.job().reason() << service.Logs();
  EXPECT_EQ(service.client().ListJobs()->size(), 1u) << "clients see what clients submitted";
  pb::ListJobsRequest of_it;
  of_it.set_parent_job(reply.job().id());
  const auto parts = service.client().ListJobs(of_it);
  ASSERT_EQ(parts->size(), 1u);
  EXPECT_EQ(parts->front().state(), pb::JOB_STATE_CANCELLED);
  EXPECT_EQ(service.client().GetJob(0)->job().id(), reply.job().id()) << "nor is it the newest job";
  EXPECT_EQ(service.client().Act(parts->front().id(), pb::JOB_ACTION_RETRY).status().code(),
            StatusCode::kFailedPrecondition);
}

TEST(Service, AWorkerMaySubmitOnlyUnderALeaseThatHolds) {
  Service service;
  service.StartWorker("a", 2);
  pb::JobSpec job;
  AddTask(&job, "t", "sleep", R"({"seconds": 60})");
  const auto id = service.client().Submit(job);
  ASSERT_TRUE(service.WaitForProgress(*id, "t"));
  const auto token = service.client().GetJob(*id, true, true)->tasks(0).attempt_list(0).token();
  const auto as_worker = [&](uint64_t lease) {
    return *coordinator::Client::Connect(
        {.address = service.endpoint(), .role = pb::ROLE_WORKER, .lease = lease});
  };
  pb::JobSpec part;
  AddTask(&part, "p", "sleep", R"({"seconds": 60})");
  EXPECT_EQ(as_worker(0)->Submit(part).status().code(), StatusCode::kPermissionDenied);
  EXPECT_EQ(as_worker(token + 7)->Submit(part).status().code(), StatusCode::kFailedPrecondition);
  const auto task = as_worker(token);
  EXPECT_EQ(task->Act(*id, pb::JOB_ACTION_CANCEL).status().code(), StatusCode::kPermissionDenied)
      << "its own job is not its to cancel";
  const auto made = task->Submit(part, "p");
  ASSERT_TRUE(made.ok()) << made.status().ToString();
  EXPECT_EQ(*task->Submit(part, "p"), *made);
  EXPECT_NE(*service.client().Submit(part, "p"), *made) << "a client's ids are its own";
  EXPECT_EQ(task->Act(*made, pb::JOB_ACTION_PAUSE).status().code(), StatusCode::kPermissionDenied);
  EXPECT_TRUE(task->Act(*made, pb::JOB_ACTION_CANCEL).ok());
  const auto open = task->Submit(part, "q");
  ASSERT_TRUE(service.client().Act(*id, pb::JOB_ACTION_CANCEL).ok());
  EXPECT_EQ(task->Submit(part, "r").status().code(), StatusCode::kFailedPrecondition);
  EXPECT_EQ(service.client().GetJob(*open)->job().state(), pb::JOB_STATE_CANCELLED);
}

TEST(Service, LargeOutputsAndInputsTravelInPieces) {
  Service service;
  service.StartWorker("a");
  pb::JobSpec job;
  AddTask(&job, "make", "blob", R"({"bytes": 5000000, "seed": 3})");
  AddInput(AddTask(&job, "copy", "echo", R"({"text": "x"})"), "in", "make");
  const auto reply = RunJob(service, job);
  ASSERT_EQ(reply.job().state(), pb::JOB_STATE_SUCCEEDED) << reply.job().reason();
  const auto made = service.client().GetArtifact(FindTask(reply, "make")->outputs(0).sha256());
  const auto copied = service.client().GetArtifact(FindTask(reply, "copy")->outputs(0).sha256());
  ASSERT_TRUE(made.ok() && copied.ok());
  EXPECT_EQ(made->size(), 5'000'000u);
  EXPECT_EQ(*copied, "x" + *made);
}

TEST(Service, ArtefactsGoInAndOutAndFeedJobs) {
  Service service;
  service.StartWorker("a");
  std::string bytes(3'000'000, 'm');
  pb::ArtifactInfo info;
  info.set_kind("model");
  info.set_metadata_json(R"({"robot": "arm"})");
  const auto sha256 = service.client().PutArtifact(bytes, info);
  ASSERT_TRUE(sha256.ok()) << sha256.status().ToString();
  EXPECT_EQ(*sha256, Sha256Hex(bytes));
  EXPECT_TRUE(service.client().PutArtifact(bytes, info).ok()) << "a repeat is harmless";
  pb::JobSpec job;
  pb::InputSpec* input = AddTask(&job, "read", "echo")->add_inputs();
  input->set_name("model");
  input->set_artifact(*sha256);
  const auto reply = RunJob(service, job);
  ASSERT_EQ(reply.job().state(), pb::JOB_STATE_SUCCEEDED) << reply.job().reason();
  EXPECT_EQ(FindTask(reply, "read")->outputs(0).sha256(), *sha256)
      << "the same bytes as another kind are no trouble";
  EXPECT_EQ(FindTask(reply, "read")->outputs(0).kind(), "text");
  pb::JobSpec wrong = job;
  wrong.mutable_tasks(0)->mutable_inputs(0)->set_artifact(std::string(64, 'a'));
  EXPECT_EQ(service.client().Submit(wrong).status().code(), StatusCode::kNotFound);
}

TEST(Service, ParametersBecomeVersionsOfTheHistory) {
  Service service;
  service.StartWorker("a");
  for (const char* value : {"1.5", "2.5"}) {
    pb::JobSpec job;
    AddTask(&job, "fit", "parameters", std::string(R"({"robot": "arm", "value": )") + value + "}");
    ASSERT_EQ(RunJob(service, job).job().state(), pb::JOB_STATE_SUCCEEDED);
  }
  const auto history = service.client().ParameterHistory("arm");
  ASSERT_TRUE(history.ok()) << history.status().ToString();
  ASSERT_EQ(history->size(), 2u);
  const auto newest = service.client().Parameters("arm");
  ASSERT_TRUE(newest.ok());
  EXPECT_EQ(newest->version(), 2u);
  EXPECT_DOUBLE_EQ(newest->values(0).value(), 2.5);
  const auto diff = service.client().DiffParameters("arm", 1);
  ASSERT_TRUE(diff.ok()) << diff.status().ToString();
  ASSERT_EQ(diff->rows_size(), 1);
  EXPECT_DOUBLE_EQ(diff->rows(0).from(), 1.5);
}

TEST(Service, AFailureIsTriedAgainUntilItsLimitThenTheJobSaysWhy) {
  Service service;
  service.StartWorker("a");
  pb::JobSpec recovers;
  AddTask(&recovers, "shaky", "fail", R"({"until": 2})");
  const auto good = RunJob(service, recovers);
  EXPECT_EQ(good.job().state(), pb::JOB_STATE_SUCCEEDED);
  EXPECT_EQ(FindTask(good, "shaky")->attempts(), 3u);
  pb::JobSpec hopeless;
  AddTask(&hopeless, "bad", "fail")->set_max_attempts(2);
  AddInput(AddTask(&hopeless, "child", "echo"), "in", "bad");
  const auto bad = RunJob(service, hopeless);
  EXPECT_EQ(bad.job().state(), pb::JOB_STATE_FAILED);
  EXPECT_NE(bad.job().reason().find("bad"), std::string::npos) << bad.job().reason();
  EXPECT_EQ(FindTask(bad, "bad")->attempts(), 2u);
  EXPECT_EQ(FindTask(bad, "bad")->attempt_list_size(), 2);
  EXPECT_EQ(FindTask(bad, "child")->state(), pb::TASK_STATE_CANCELLED);
  pb::JobSpec invalid;  // invalid input: no second attempt
  AddTask(&invalid, "bad", "fail", R"({"code": 1})");
  EXPECT_EQ(FindTask(RunJob(service, invalid), "bad")->attempts(), 1u);
}

TEST(Service, AnOptionalInputOfAFailedTaskIsLeftOut) {
  Service service;
  service.StartWorker("a");
  pb::JobSpec job;
  AddTask(&job, "bad", "fail")->set_max_attempts(1);
  AddTask(&job, "good", "echo", R"({"text": "g"})");
  pb::TaskSpec* join = AddTask(&job, "join", "echo", R"({"text": "j"})");
  AddInput(join, "a", "bad", true);
  AddInput(join, "b", "good");
  const auto reply = RunJob(service, job);
  EXPECT_EQ(reply.job().state(), pb::JOB_STATE_SUCCEEDED) << reply.job().reason();
  EXPECT_EQ(*service.client().GetArtifact(FindTask(reply, "join")->outputs(0).sha256()), "jg");
}

TEST(Service, ATaskThatKillsItsExecutorsIsSetAsideWithItsLog) {
  Service service;
  service.StartWorker("a");
  pb::JobSpec job;
  AddTask(&job, "killer", "crash")->set_crash_limit(2);
  const auto reply = RunJob(service, job);
  EXPECT_EQ(reply.job().state(), pb::JOB_STATE_FAILED);
  EXPECT_TRUE(FindTask(reply, "killer")->set_aside());
  EXPECT_EQ(FindTask(reply, "killer")->attempts(), 2u);
  EXPECT_NE(reply.job().reason().find("set aside"), std::string::npos) << reply.job().reason();
  EXPECT_NE(reply.job().reason().find("famous last words"), std::string::npos) << reply.job().reason();
  const auto logs = service.client().Logs(reply.job().id(), "killer");
  ASSERT_TRUE(logs.ok());
  EXPECT_EQ(logs->lines_size(), 2);
  pb::JobSpec after;  // the worker is as good as new
  AddTask(&after, "once", "crash", R"({"until": 1})");
  EXPECT_EQ(RunJob(service, after).job().state(), pb::JOB_STATE_SUCCEEDED);
}

TEST(Service, BytesThatAreNoTextReachNobodyAsSuch) {
  Service service;
  service.StartWorker("a");
  pb::JobSpec job;
  AddTask(&job, "t", "garble")->set_max_attempts(1);
  const auto reply = RunJob(service, job);
  EXPECT_EQ(reply.job().state(), pb::JOB_STATE_FAILED);
  EXPECT_NE(reply.job().reason().find("failed ??"), std::string::npos) << reply.job().reason();
  const auto logs = service.client().Logs(reply.job().id());
  ASSERT_TRUE(logs.ok()) << logs.status().ToString();
  std::string text;
  for (const auto& line : logs->lines()) text += line.text() + "\n";
  EXPECT_NE(text.find("printed ??"), std::string::npos) << text;
  EXPECT_NE(text.find("logged ??"), std::string::npos) << text;
}

TEST(Service, ATaskPastItsTimeoutIsStopped) {
  Service service;
  service.StartWorker("a");
  pb::JobSpec job;
  pb::TaskSpec* task = AddTask(&job, "endless", "hang");
  task->set_timeout_s(0.3);
  task->set_max_attempts(1);
  const auto reply = RunJob(service, job);
  EXPECT_EQ(reply.job().state(), pb::JOB_STATE_FAILED);
  EXPECT_EQ(FindTask(reply, "endless")->attempt_list(0).outcome(), pb::ATTEMPT_OUTCOME_TIMED_OUT);
}

TEST(Service, CancelIsFinalAndStopsWhatRuns) {
  Service service;
  service.StartWorker("a");
  pb::JobSpec job;
  AddTask(&job, "long", "sleep", R"({"seconds": 60})");
  AddTask(&job, "next", "echo");
  const auto id = service.client().Submit(job);
  ASSERT_TRUE(id.ok());
  ASSERT_TRUE(service.WaitForTask(*id, "long", pb::TASK_STATE_LEASED));
  const auto cancelled = service.client().Act(*id, pb::JOB_ACTION_CANCEL, "not needed");
  ASSERT_TRUE(cancelled.ok()) << cancelled.status().ToString();
  EXPECT_EQ(cancelled->state(), pb::JOB_STATE_CANCELLED);
  EXPECT_EQ(cancelled->reason(), "not needed");
  EXPECT_EQ(service.client().Act(*id, pb::JOB_ACTION_RETRY).status().code(), StatusCode::kFailedPrecondition);
  pb::JobSpec after;  // its slot is free again
  AddTask(&after, "quick", "echo");
  EXPECT_EQ(RunJob(service, after).job().state(), pb::JOB_STATE_SUCCEEDED);
}

// Its worker gives a cancelled task 0.3 s; this kind has more, as a rollout whose arm is being stopped.
TEST(Service, ACancelledTaskOfAKindThatNeedsLongerIsNotKilled) {
  Service service;
  service.StartWorker("a");
  const std::string path = service.folder() + "/stopped";
  pb::JobSpec job;
  AddTask(&job, "arm", "stop_slowly", R"({"needs": 1.5, "path": ")" + path + R"("})");
  const auto id = service.client().Submit(job);
  ASSERT_TRUE(id.ok());
  ASSERT_TRUE(service.WaitForTask(*id, "arm", pb::TASK_STATE_LEASED));
  std::this_thread::sleep_for(std::chrono::milliseconds(300));
  ASSERT_TRUE(service.client().Act(*id, pb::JOB_ACTION_CANCEL, "not needed").ok());
  for (int i = 0; i < 400 && !std::filesystem::exists(path); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  EXPECT_TRUE(std::filesystem::exists(path)) << service.Logs();
}

TEST(Service, APausedJobStartsNothingUntilItIsResumed) {
  Service service;
  pb::JobSpec job;
  AddTask(&job, "t", "echo");
  const auto id = service.client().Submit(job);
  ASSERT_TRUE(id.ok());
  ASSERT_TRUE(service.client().Act(*id, pb::JOB_ACTION_PAUSE).ok());
  service.StartWorker("a");
  ASSERT_TRUE(service.WaitForWorkers(1));
  pb::JobSpec other;
  AddTask(&other, "o", "echo");
  RunJob(service, other);
  EXPECT_EQ(service.client().GetJob(*id)->job().state(), pb::JOB_STATE_PAUSED);
  EXPECT_NE(service.client().Explain(*id)->reasons(0).find("paused"), std::string::npos);
  ASSERT_TRUE(service.client().Act(*id, pb::JOB_ACTION_RESUME).ok());
  EXPECT_EQ(service.client().WaitForJob(*id, kPatience)->job().state(), pb::JOB_STATE_SUCCEEDED);
}

TEST(Service, ExplainsWhyATaskWaits) {
  Service service;
  pb::JobSpec job;
  AddTask(&job, "t", "echo")->add_required_tags("cell:none");
  AddInput(AddTask(&job, "u", "echo"), "in", "t");
  const auto id = service.client().Submit(job);
  ASSERT_TRUE(id.ok());
  EXPECT_EQ(service.client().Explain(*id)->reasons(0), "no worker is connected");
  service.StartWorker("a");
  ASSERT_TRUE(service.WaitForWorkers(1));
  const auto placed = service.client().Explain(*id);
  EXPECT_FALSE(placed->placeable());
  EXPECT_NE(placed->reasons(0).find("cell:none"), std::string::npos) << placed->reasons(0);
  EXPECT_NE(service.client().Explain(*id, "u")->reasons(0).find("parents: t"), std::string::npos);
  service.StartWorker("b", 1, {"--tag", "cell:none"});
  EXPECT_EQ(service.client().WaitForJob(*id, kPatience)->job().state(), pb::JOB_STATE_SUCCEEDED);
}

TEST(Service, ADrainedWorkerFinishesAndLeaves) {
  Service service;
  service.StartWorker("a");
  pb::JobSpec job;
  AddTask(&job, "t", "sleep", R"({"seconds": 2.0})");
  AddTask(&job, "u", "sleep", R"({"seconds": 0.1})");
  const auto id = service.client().Submit(job);
  ASSERT_TRUE(service.WaitForProgress(*id, "t"));
  service.worker("a").Signal(SIGTERM);
  EXPECT_EQ(service.worker("a").WaitForExit(kPatience), 0);
  const auto reply = service.client().GetJob(*id);
  EXPECT_EQ(FindTask(*reply, "t")->state(), pb::TASK_STATE_SUCCEEDED);
  EXPECT_EQ(FindTask(*reply, "u")->state(), pb::TASK_STATE_READY);
  service.StartWorker("b");
  EXPECT_EQ(service.client().WaitForJob(*id, kPatience)->job().state(), pb::JOB_STATE_SUCCEEDED);
  ASSERT_TRUE(service.client().DrainWorker("b").ok());
  EXPECT_EQ(service.worker("b").WaitForExit(kPatience), 0);
  EXPECT_EQ(service.client().DrainWorker("nobody").code(), StatusCode::kNotFound);
}

TEST(Service, ASubmitIsIdempotentByItsRequestId) {
  Service service;
  pb::JobSpec job;
  AddTask(&job, "t", "echo");
  const auto first = service.client().Submit(job, "the-same");
  const auto second = service.client().Submit(job, "the-same");
  ASSERT_TRUE(first.ok() && second.ok());
  EXPECT_EQ(*first, *second);
  EXPECT_NE(*service.client().Submit(job, "another"), *first);
  EXPECT_EQ(service.client().ListJobs()->size(), 2u);
}

TEST(Service, CollectingGarbageTakesNothingThatAJobRefersTo) {
  Service service;
  pb::ArtifactInfo info;
  info.set_kind("data");
  const auto input = service.client().PutArtifact("an input", info);
  const auto loose = service.client().PutArtifact(std::string(3'000'000, 'l'), info);
  ASSERT_TRUE(input.ok() && loose.ok());
  pb::JobSpec job;
  pb::InputSpec* in = AddTask(&job, "first", "echo", R"({"text": "1"})")->add_inputs();
  in->set_name("in");
  in->set_artifact(*input);
  AddTask(&job, "gate", "sleep", R"({"seconds": 0.2})");
  pb::TaskSpec* second = AddTask(&job, "second", "echo", R"({"text": "2"})");
  AddInput(second, "from first", "first");
  second->add_after("gate");
  *second->add_inputs() = *in;
  const auto id = service.client().Submit(job);
  ASSERT_TRUE(id.ok());
  const auto would = service.client().CollectGarbage(0, true);
  ASSERT_TRUE(would.ok()) << would.status().ToString();
  ASSERT_EQ(would->removed_size(), 1);
  EXPECT_EQ(would->removed(0).sha256(), *loose);
  EXPECT_TRUE(service.client().ShowArtifact(*loose).ok()) << "a dry run";
  EXPECT_EQ(service.client().CollectGarbage(0, false)->removed_size(), 1);  // nothing has run yet
  service.StartWorker("a", 2);
  ASSERT_TRUE(service.WaitForTask(*id, "first", pb::TASK_STATE_SUCCEEDED));
  EXPECT_EQ(service.client().CollectGarbage(0, false)->removed_size(), 0);
  const auto end = service.client().WaitForJob(*id, kPatience);
  ASSERT_TRUE(end.ok());
  EXPECT_EQ(end->job().state(), pb::JOB_STATE_SUCCEEDED) << end->job().reason();
  EXPECT_EQ(service.client().CollectGarbage(0, false)->removed_size(), 0) << "nor once it is over";
  const std::string result = FindTask(*service.client().GetJob(*id), "second")->outputs(0).sha256();
  EXPECT_EQ(*service.client().GetArtifact(result), "21an inputan input");
  ASSERT_TRUE(service.client().Pin(result, "user").ok());
  EXPECT_EQ(service.client().CollectGarbage(0, false, 1)->removed_size(), 1) << "what the gate said, no more";
  EXPECT_TRUE(service.client().ShowArtifact(*input).ok()) << "it made a pinned one";
  ASSERT_TRUE(service.client().Pin(result, "user", true).ok());
  EXPECT_GE(service.client().CollectGarbage(0, false, 1)->removed_size(), 3)
      << "unless old jobs are forgotten";
}

TEST(Service, TheSecondWorkerOfANameEndsInOneLineAndTheFirstWorksOn) {
  Service service;
  service.StartWorker("a");
  ASSERT_TRUE(service.WaitForWorkers(1));
  pb::JobSpec job;
  AddTask(&job, "t", "sleep", R"({"seconds": 1.5})");
  const auto id = service.client().Submit(job);
  ASSERT_TRUE(service.WaitForProgress(*id, "t"));
  const std::string log = service.folder() + "/second.log";
  Process second({BinFolder() + "/synthetic_worker", "--coordinator", service.endpoint(), "--name", "a",
                  "--folder", service.folder() + "/second"},
                 log);
  EXPECT_EQ(second.WaitForExit(kPatience), 1);
  EXPECT_NE(ReadFile(log)->find("the worker name 'a' is taken by a process that is at work"),
            std::string::npos)
      << *ReadFile(log);
  ASSERT_EQ(service.client().WaitForJob(*id, kPatience)->job().state(), pb::JOB_STATE_SUCCEEDED);
  EXPECT_EQ(service.client().GetJob(*id)->tasks(0).attempts(), 1u);
  EXPECT_EQ(service.Counter("workers_lost_total"), 0.0);
  service.worker("a").KillNow();  // and the same name comes back after a kill
  service.StartWorker("a");
  pb::JobSpec after;
  AddTask(&after, "u", "echo");
  EXPECT_EQ(RunJob(service, after).job().state(), pb::JOB_STATE_SUCCEEDED);
}

TEST(Service, ACoordinatorThatWasStoppedLosesNoWorker) {
  Service service;
  service.StartWorker("a");
  service.StartWorker("b");
  ASSERT_TRUE(service.WaitForWorkers(2));
  pb::JobSpec job;
  for (int i = 0; i < 2; ++i) AddTask(&job, "t" + std::to_string(i), "sleep", R"({"seconds": 3})");
  const auto id = service.client().Submit(job);
  ASSERT_TRUE(service.WaitForProgress(*id, "t0") && service.WaitForProgress(*id, "t1"));
  service.coordinator().Signal(SIGSTOP);  // two leases long
  std::this_thread::sleep_for(std::chrono::milliseconds(1'600));
  service.coordinator().Signal(SIGCONT);
  ASSERT_EQ(service.client().WaitForJob(*id, kPatience)->job().state(), pb::JOB_STATE_SUCCEEDED);
  EXPECT_EQ(service.Counter("workers_lost_total"), 0.0) << service.Logs();
  EXPECT_EQ(service.Counter("attempts_lost_total"), 0.0);
  EXPECT_GE(service.Counter("stalls_total"), 1.0);
}

TEST(Service, AllJobsAreReachedHoweverManyThereAre) {
  Service service;
  pb::JobSpec job;
  AddTask(&job, "t", "echo");
  constexpr size_t kJobs = 230;
  for (size_t i = 0; i < kJobs; ++i) ASSERT_TRUE(service.client().Submit(job).ok());
  EXPECT_EQ(service.client().ListJobs()->size(), 100u);
  const auto all = service.client().ListAllJobs();
  ASSERT_TRUE(all.ok());
  ASSERT_EQ(all->size(), kJobs);
  EXPECT_EQ(all->back().id(), 1);
}

TEST(Service, LogsAndEventsComeFromTheReadersByNameAndPage) {
  Service service;
  service.StartWorker("a");
  pb::JobSpec job;
  AddTask(&job, "one", "count", R"({"to": 3, "step_seconds": 0.01})");
  AddTask(&job, "two", "count", R"({"to": 2, "step_seconds": 0.01})");
  const auto reply = RunJob(service, job);
  ASSERT_EQ(reply.job().state(), pb::JOB_STATE_SUCCEEDED);
  const auto all = service.client().Logs(0);  // the newest job
  ASSERT_TRUE(all.ok()) << all.status().ToString();
  EXPECT_EQ(all->lines_size(), 5);
  const auto of_two = service.client().Logs(reply.job().id(), "two");
  ASSERT_EQ(of_two->lines_size(), 2);
  EXPECT_EQ(of_two->lines(0).task(), "two");
  EXPECT_EQ(service.client().Logs(reply.job().id(), "", all->lines(3).sequence())->lines_size(), 1);
  EXPECT_EQ(service.client().Logs(99).status().message(), "there is no job 99");
  EXPECT_EQ(service.client().Logs(reply.job().id(), "three").status().code(), StatusCode::kNotFound);
  const auto events = service.client().Events(reply.job().id());
  ASSERT_TRUE(events.ok());
  ASSERT_EQ(events->size(), 2u);
  EXPECT_EQ(service.client().Events(reply.job().id(), events->front().id())->size(), 1u);
}

TEST(Service, ABackupIsMadeWhileItWorks) {
  Service service;
  service.StartWorker("a");
  pb::JobSpec job;
  AddTask(&job, "t", "echo", R"({"text": "kept"})");
  const auto reply = RunJob(service, job);
  const auto backup = service.client().Backup("copy.db");
  ASSERT_TRUE(backup.ok()) << backup.status().ToString();
  EXPECT_GT(backup->bytes(), 10'000u);
  EXPECT_EQ(service.client().Backup("copy.db").status().code(), StatusCode::kAlreadyExists);
  EXPECT_EQ(service.client().Backup("../copy.db").status().code(), StatusCode::kInvalid);
  const auto copy =
      store::Database::Open({.path = backup->path(), .read_only = true}, {store::ArtifactStore::Schema()});
  ASSERT_TRUE(copy.ok()) << copy.status().ToString();
  EXPECT_TRUE((*copy)->CheckIntegrity().ok());
  const auto artifacts = store::ArtifactStore::Open(copy->get(), &RealClock());
  EXPECT_EQ(*(*artifacts)->Get(FindTask(reply, "t")->outputs(0).sha256()), "kept");
}

TEST(Service, TwoWorkersShareTheWorkAndOneThatJoinsLateGetsSome) {
  Service service;
  service.StartWorker("a");
  pb::JobSpec job;
  for (int i = 0; i < 30; ++i) AddTask(&job, "t" + std::to_string(i), "sleep", R"({"seconds": 0.1})");
  const auto id = service.client().Submit(job);
  ASSERT_TRUE(service.WaitForTask(*id, "t3", pb::TASK_STATE_SUCCEEDED));
  service.StartWorker("b");
  ASSERT_EQ(service.client().WaitForJob(*id, kPatience)->job().state(), pb::JOB_STATE_SUCCEEDED);
  std::map<std::string, int> by_worker;
  const auto reply = service.client().GetJob(*id, true, true);
  for (const auto& task : reply->tasks()) ++by_worker[task.attempt_list(0).worker()];
  EXPECT_GT(by_worker["a"], 3);
  EXPECT_GT(by_worker["b"], 3);
}

TEST(Service, HigherPriorityGoesFirst) {
  Service service;
  pb::JobSpec low, high;
  AddTask(&low, "l", "echo");
  AddTask(&high, "h", "echo");
  high.set_priority(5);
  const auto l = service.client().Submit(low);
  const auto h = service.client().Submit(high);
  service.StartWorker("a");
  ASSERT_TRUE(service.client().WaitForJob(*l, kPatience).ok());
  ASSERT_TRUE(service.client().WaitForJob(*h, kPatience).ok());
  EXPECT_LT(service.client().GetJob(*h, true, true)->tasks(0).attempt_list(0).token(),
            service.client().GetJob(*l, true, true)->tasks(0).attempt_list(0).token());
}

TEST(Service, APriorityChangedLaterDecidesWhoIsNext) {
  Service service;
  pb::JobSpec job;
  AddTask(&job, "t", "echo");
  const auto first = service.client().Submit(job), second = service.client().Submit(job);
  ASSERT_TRUE(service.client().SetPriority(*second, 7).ok());
  service.KillCoordinator();
  service.StartCoordinator();
  EXPECT_EQ(service.client().GetJob(*second)->job().priority(), 7) << "over a restart";
  EXPECT_EQ(service.client().SetPriority(*second, 1'000'001).status().code(), StatusCode::kInvalid);
  service.StartWorker("a");
  ASSERT_TRUE(service.client().WaitForJob(*first, kPatience).ok());
  ASSERT_TRUE(service.client().WaitForJob(*second, kPatience).ok());
  EXPECT_LT(service.client().GetJob(*second, true, true)->tasks(0).attempt_list(0).token(),
            service.client().GetJob(*first, true, true)->tasks(0).attempt_list(0).token());
  EXPECT_EQ(service.client().SetPriority(*second, 3).status().code(), StatusCode::kFailedPrecondition);
}

TEST(Service, AJobComesAfterOthersOverARestartAndFailsWhereOneDoes) {
  Service service;
  service.StartWorker("a", 2);
  pb::JobSpec slow, after;
  AddTask(&slow, "t", "sleep", R"({"seconds": 1.0})");
  AddTask(&after, "t", "echo");
  const auto before = service.client().Submit(slow);
  after.add_after_jobs(*before);
  const auto id = service.client().Submit(after);
  ASSERT_TRUE(id.ok()) << id.status().ToString();
  service.KillCoordinator();
  service.StartCoordinator();
  const auto waiting = service.client().GetJob(*id);
  ASSERT_EQ(waiting->job().after_jobs_size(), 1);
  if (service.client().GetJob(*before)->job().state() != pb::JOB_STATE_SUCCEEDED) {
    EXPECT_EQ(waiting->job().state(), pb::JOB_STATE_QUEUED);
    EXPECT_EQ(waiting->job().waits_for(0), *before);
  }
  ASSERT_EQ(service.client().WaitForJob(*id, kPatience)->job().state(), pb::JOB_STATE_SUCCEEDED);
  const auto early = service.client().GetJob(*before), late = service.client().GetJob(*id);
  EXPECT_GE(late->job().started_ns(), early->job().finished_ns());
  EXPECT_TRUE(service.client().Submit(after).ok()) << "after one that is over and out of memory";

  pb::JobSpec bad, third;
  AddTask(&bad, "t", "fail", R"({"code": 1})");
  AddTask(&third, "t", "echo");
  bad.add_after_jobs(*service.client().Submit(slow));
  third.add_after_jobs(*service.client().Submit(bad));
  const auto doomed = service.client().Submit(third);
  ASSERT_TRUE(doomed.ok()) << doomed.status().ToString();
  const auto end = service.client().WaitForJob(*doomed, kPatience);
  EXPECT_EQ(end->job().state(), pb::JOB_STATE_FAILED);
  EXPECT_NE(end->job().reason().find("comes after it"), std::string::npos) << end->job().reason();
  EXPECT_EQ(service.client().Act(*doomed, pb::JOB_ACTION_RETRY).status().code(),
            StatusCode::kFailedPrecondition);
  EXPECT_EQ(service.client().Submit(third).status().code(), StatusCode::kFailedPrecondition);
  third.set_after_jobs(0, 99);
  EXPECT_EQ(service.client().Submit(third).status().code(), StatusCode::kNotFound);
}

TEST(Service, AJobPastItsTimeLimitFailsAndWhatRunsIsStopped) {
  Service service;
  service.StartWorker("a");
  pb::JobSpec job;
  AddTask(&job, "t", "sleep", R"({"seconds": 600})");
  job.set_time_limit_s(1.0);
  const auto end = RunJob(service, job);
  EXPECT_EQ(end.job().state(), pb::JOB_STATE_FAILED);
  EXPECT_EQ(end.job().reason(), "its time limit of 1 s is over");
  EXPECT_GE(end.job().finished_ns() - end.job().started_ns(), 1'000'000'000);
  pb::JobSpec quick;
  AddTask(&quick, "t", "echo");
  EXPECT_EQ(RunJob(service, quick).job().state(), pb::JOB_STATE_SUCCEEDED) << "its slot is free again";
}

TEST(Service, ATaskHasAScratchFolderOnlyWhereItWantsOne) {
  Service service;
  service.StartWorker("a", 1);
  ASSERT_TRUE(service.WaitForWorkers(1));
  pb::JobSpec job;
  AddTask(&job, "t", "sleep", R"({"seconds": 60})");
  const auto id = service.client().Submit(job);
  ASSERT_TRUE(service.WaitForProgress(*id, "t"));
  const std::string scratch = service.folder() + "/worker-a/scratch";
  const auto folders = [&] {
    std::error_code error;
    int count = 0;
    for (const auto& entry : std::filesystem::recursive_directory_iterator(scratch, error))
      count += entry.is_directory();
    return count;
  };
  EXPECT_EQ(folders(), 0) << "a folder made and removed costs more than a short task";
  ASSERT_TRUE(service.client().Act(*id, pb::JOB_ACTION_CANCEL).ok());
}

}  // namespace
}  // namespace rg::testing
