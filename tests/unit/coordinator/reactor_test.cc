// Scenarios of the reactor, step by step; the promises are checked after each event.
#include "coordinator/core/reactor.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <deque>
#include <map>

#include "tests/unit/coordinator/reactor_fixture.h"

namespace rg::coordinator {
namespace {

using Reactor = ReactorTest;

TEST_F(Reactor, ATaskSubmitsUnderItsLeaseAndWhatItSubmitsEndsWithIt) {
  Join("a", 4);
  const JobId job = SubmitJob({MakeTask("lead"), MakeTask("after", {{0, false}})});
  const Assign lead = Sent<Assign>(last_).at(0);
  const auto submit = [&](const std::string& id, Token lease) {
    auto plan = std::make_shared<JobPlan>(*MakePlan({MakeTask("part")}));
    plan->parent = lead.task;
    return Sent<AnswerClient>(Do(Submit{id, plan, nullptr, 1, lease})).at(0);
  };
  EXPECT_EQ(submit("parts", lead.token + 1).verdict, Verdict::kFailedPrecondition);
  const AnswerClient made = submit("parts", lead.token);
  ASSERT_EQ(made.verdict, Verdict::kOk);
  EXPECT_EQ(Phase(made.job, 0), TaskPhase::kLeased);
  EXPECT_EQ(state_.newest_of_clients, job);
  Pass(3);
  Do(Tick{});  // the worker is lost, and both leases with it
  EXPECT_EQ(submit("more", lead.token).verdict, Verdict::kFailedPrecondition) << "of a lease that was lost";
  EXPECT_EQ(Phase(made.job), JobPhase::kRunning) << "another attempt may want it";
  Join("b", 4);
  const std::vector<Assign> again = Sent<Assign>(last_);
  ASSERT_EQ(again.size(), 2u);
  const Assign second = again[again[0].task == lead.task ? 0 : 1];
  const AnswerClient found = submit("parts", second.token);
  EXPECT_TRUE(found.already_known);
  EXPECT_EQ(found.job, made.job);
  Do(Finished{"b#1", lead.task, second.token});
  EXPECT_EQ(Phase(made.job), JobPhase::kCancelled) << "its task is over";
  EXPECT_EQ(Phase(job, 1), TaskPhase::kLeased);
  EXPECT_EQ(submit("late", second.token).verdict, Verdict::kFailedPrecondition);
}

TEST_F(Reactor, AFailureOfTheNodeCostsNoAttemptAndGoesToAnotherUpToALimit) {
  Join("a");
  TaskPlan once = MakeTask("t");
  once.max_attempts = 1;
  const JobId job = SubmitJob({once});
  Assign at = Sent<Assign>(last_).at(0);
  Join("b");
  Failed full{"a#1", at.task, at.token, Outcome::kLost, "disk full", true, true};
  last_ = Do(full);
  at = Sent<Assign>(last_).at(0);
  EXPECT_EQ(at.instance, "b#1") << "the other one is asked first";
  for (uint32_t i = 1; i < state_.options.max_losses; ++i) {
    ASSERT_EQ(Phase(job), JobPhase::kRunning) << i;
    last_ = Do(Failed{at.instance, at.task, at.token, Outcome::kLost, "disk full", true, true});
    if (!Sent<Assign>(last_).empty()) at = Sent<Assign>(last_)[0];
  }
  EXPECT_EQ(Phase(job), JobPhase::kFailed) << "or it would go round for ever";
  EXPECT_NE(state_.jobs.at(job).record.reason.find("disk full"), std::string::npos);
}

TEST_F(Reactor, AWorkerWhereTasksFailThatOthersFinishRestsAndIsTriedAgainWithOne) {
  Join("bad", 2);
  Join("good");
  std::vector<TaskPlan> tasks;
  for (int i = 0; i < 12; ++i) tasks.push_back(MakeTask("t" + std::to_string(i)));
  SubmitJob(tasks);
  std::deque<Assign> given;
  const auto take = [&](const Actions& actions) {
    for (const Assign& assign : Sent<Assign>(actions)) given.push_back(assign);
  };
  const auto answer = [&](const Assign& assign) {
    const bool fails = assign.instance == "bad#1";
    return fails ? Do(Failed{assign.instance, assign.task, assign.token, Outcome::kFailed, "no library", true})
                 : Do(Finished{assign.instance, assign.task, assign.token});
  };
  take(last_);
  const Worker& bad = state_.workers.at("bad");
  for (int i = 0; i < 30 && bad.suspect.empty(); ++i) {
    const Assign next = given.front();
    given.pop_front();
    take(answer(next));
  }
  EXPECT_EQ(bad.why_unable(), "fails tasks that others finish: no library");
  const auto at_bad = [&] {
    return std::count_if(given.begin(), given.end(), [](const Assign& a) { return a.instance == "bad#1"; });
  };
  const auto before = at_bad();
  const uint64_t failed = bad.tasks_failed;
  while (!given.empty() && given.front().instance == "good#1") {
    const Assign next = given.front();
    given.pop_front();
    take(answer(next));
    if (at_bad() > before) break;
  }
  EXPECT_EQ(at_bad(), before) << "it is given nothing";
  EXPECT_EQ(bad.tasks_failed, failed);
  SubmitJob({MakeTask("later"), MakeTask("later still")});
  take(last_);
  const auto renew = [&] {
    for (const char* name : {"bad#1", "good#1"}) {
      WorkerBeat beat{name, {}};
      for (const auto& [token, lease] : state_.leases) {
        if (lease.instance == name) beat.held.push_back(token);
      }
      Do(beat);
    }
  };
  for (int i = 0; i < 10 && !bad.suspect.empty(); ++i) Pass(1), renew(), take(Do(Tick{}));
  EXPECT_TRUE(bad.suspect.empty()) << "by itself";
  EXPECT_EQ(at_bad(), 1) << "one at a time";
}

TEST_F(Reactor, NothingBeginsOnAHeldRobotUntilItIsReleased) {
  Join("agent", 1, {}, {"robot:one"});
  TaskPlan rollout = MakeTask("rollout");
  rollout.at_most_once = true;
  rollout.required_tags = {"robot:one"};
  const JobId job = SubmitJob({rollout});
  const Assign given = Sent<Assign>(last_).at(0);
  last_ = Do(HoldRobot{"one", "belt replaced", "anna", false, 1});
  EXPECT_EQ(Sent<AnswerClient>(last_).at(0).verdict, Verdict::kOk);
  ASSERT_EQ(Sent<Revoke>(last_).size(), 1u) << "it has not begun";
  EXPECT_TRUE(Sent<GrantStart>(Do(StartRequested{"agent#1", given.token})).empty());
  EXPECT_TRUE(Sent<Assign>(Do(WorkerBeat{"agent#1", {}})).empty());
  EXPECT_EQ(WhyItWaits(state_, state_.jobs.at(job)), "agent: is held by anna: belt replaced");
  Join("agent", 1, {}, {"robot:one"});
  EXPECT_TRUE(Sent<Assign>(last_).empty()) << "whoever comes back";
  EXPECT_EQ(Sent<AnswerClient>(Do(HoldRobot{"two", "", "ben", true, 1})).at(0).verdict, Verdict::kFailedPrecondition);
  last_ = Do(HoldRobot{"one", "", "ben", true, 1});
  EXPECT_EQ(Sent<Assign>(last_).size(), 1u);
  EXPECT_EQ(store_.notes["robot.held"] + store_.notes["robot.released"], 2);
}

TEST_F(Reactor, TasksThatFailEverywhereAreNotTheFaultOfTheWorkers) {
  Join("a");
  Join("b");
  std::vector<TaskPlan> tasks;
  for (int i = 0; i < 6; ++i) tasks.push_back(MakeTask("t" + std::to_string(i)));
  const JobId job = SubmitJob(tasks);
  std::deque<Assign> given;
  for (const Assign& assign : Sent<Assign>(last_)) given.push_back(assign);
  while (!given.empty()) {
    const Assign next = given.front();
    given.pop_front();
    for (const Assign& assign :
         Sent<Assign>(Do(Failed{next.instance, next.task, next.token, Outcome::kFailed, "wrong", true})))
      given.push_back(assign);
  }
  EXPECT_EQ(Phase(job), JobPhase::kFailed);
  for (const auto& [name, worker] : state_.workers) EXPECT_EQ(worker.why_unable(), "");
}

TEST_F(Reactor, AChildIsAssignedOnlyAfterItsParentCommitted) {
  Join("a", 4);
  const JobId job = SubmitJob({MakeTask("p"), MakeTask("c", {{0, false}})});
  auto assigned = Sent<Assign>(last_);
  ASSERT_EQ(assigned.size(), 1u);
  EXPECT_EQ(assigned[0].task, MakeTaskId(job, 0));
  last_ = Do(Finished{"a#1", assigned[0].task, assigned[0].token});
  EXPECT_TRUE(Sent<AnswerResult>(last_).at(0).accepted);
  ASSERT_EQ(Sent<Assign>(last_).size(), 1u);
  EXPECT_EQ(Sent<Assign>(last_)[0].task, MakeTaskId(job, 1));
}

TEST_F(Reactor, WhatDidNotGoAsAskedIsTheReasonOfTaskAndJobThoughTheySucceed) {
  Join("a");
  const JobId job = SubmitJob({MakeTask("rollout"), MakeTask("rest", {{0, false}})});
  const Assign first = Sent<Assign>(last_).at(0);
  Finished early{"a#1", first.task, first.token};
  early.remark = "stopped after 1.4 of 6 s";
  last_ = Do(early);
  const bool on_task = std::any_of(last_.rows.begin(), last_.rows.end(), [&](const Row& row) {
    const auto* update = std::get_if<UpdateTask>(&row);
    return update != nullptr && update->task == first.task && update->reason == early.remark;
  });
  EXPECT_TRUE(on_task);
  EXPECT_EQ(state_.jobs.at(job).record.reason, "stopped after 1.4 of 6 s") << "as soon as it is known";
  Do(CommandJob{job, JobCommand::kPause, "", 1});
  Do(CommandJob{job, JobCommand::kResume, "", 1});
  const Assign second = Sent<Assign>(last_).at(0);
  Do(Finished{"a#1", second.task, second.token});
  EXPECT_EQ(Phase(job), JobPhase::kSucceeded);
  EXPECT_EQ(state_.jobs.at(job).record.reason, "stopped after 1.4 of 6 s");
}

TEST_F(Reactor, ARepeatedResultIsAcceptedOnceAndAnOldOneRefused) {
  Join("a");
  SubmitJob({MakeTask("t")});
  const Assign first = Sent<Assign>(last_).at(0);
  Pass(2.5);
  Join("b");
  last_ = Do(Tick{});
  const Assign second = Sent<Assign>(last_).at(0);
  EXPECT_GT(second.token, first.token);
  EXPECT_EQ(second.attempt, 2u);
  last_ = Do(Finished{"a#1", first.task, first.token});
  EXPECT_FALSE(Sent<AnswerResult>(last_).at(0).accepted);
  EXPECT_EQ(state_.counters.results_refused, 1u);
  last_ = Do(Finished{"b#1", second.task, second.token});
  EXPECT_TRUE(Sent<AnswerResult>(last_).at(0).accepted);
  last_ = Do(Finished{"b#1", second.task, second.token});
  EXPECT_TRUE(Sent<AnswerResult>(last_).at(0).accepted) << "the first answer may have been lost";
  EXPECT_EQ(store_.commits.at(second.task), 1);
}

TEST_F(Reactor, AWorkerIsLostAfterTwoHeartbeatsNotBefore) {
  Join("a");
  SubmitJob({MakeTask("t")});
  Pass(1.9);
  Do(Tick{});
  EXPECT_EQ(Phase(1, 0), TaskPhase::kLeased);
  Pass(0.2);
  Do(Tick{});
  EXPECT_EQ(Phase(1, 0), TaskPhase::kReady);
  last_ = Do(WorkerBeat{"a#1", {1}, false});
  EXPECT_FALSE(Sent<AnswerBeat>(last_).at(0).known);
}

TEST_F(Reactor, AHeartbeatRenewsOnlyTheLeasesItNames) {
  Join("a", 2);
  SubmitJob({MakeTask("t"), MakeTask("u")});
  ASSERT_EQ(Sent<Assign>(last_).size(), 2u);
  for (int i = 0; i < 5; ++i) {
    Pass(0.5);
    Do(WorkerBeat{"a#1", {1}, false});
    Do(Tick{});
  }
  EXPECT_EQ(Phase(1, 0), TaskPhase::kLeased);
  EXPECT_EQ(state_.leases.count(2), 0u) << "its assignment was lost on the way";
}

TEST_F(Reactor, ALeaseOutlivesARestartIfItsWorkerComesBackInTime) {
  Join("a");
  SubmitJob({MakeTask("t")});
  const Token token = Sent<Assign>(last_).at(0).token;
  state_ = Restore(store_.Load(), state_.options, {ns_, 0});
  Pass(1.0);
  Join("a", 1, {token});
  EXPECT_TRUE(Sent<Assign>(last_).empty());
  last_ = Do(Finished{"a#1", MakeTaskId(1, 0), token});
  EXPECT_TRUE(Sent<AnswerResult>(last_).at(0).accepted);
}

TEST_F(Reactor, AnAssignmentLostInARestartIsGivenAgain) {
  Join("a");
  SubmitJob({MakeTask("t")});  // committed, then killed before the message left
  state_ = Restore(store_.Load(), state_.options, {ns_, 0});
  Join("a");
  ASSERT_EQ(Sent<Assign>(last_).size(), 1u);
  EXPECT_EQ(Sent<Assign>(last_)[0].attempt, 2u);
}

TEST_F(Reactor, AnAtMostOnceTaskThatNeverStartedIsGivenToAnother) {
  TaskPlan rollout = MakeTask("rollout");
  rollout.at_most_once = true;
  Join("a");
  SubmitJob({rollout});
  Pass(2.5);
  Join("b");
  last_ = Do(Tick{});
  EXPECT_EQ(Sent<Assign>(last_).size(), 1u);
  last_ = Do(StartRequested{"a#1", 1});  // late: must not be let through
  EXPECT_TRUE(Sent<GrantStart>(last_).empty());
  EXPECT_EQ(Sent<Revoke>(last_).size(), 1u);
}

TEST_F(Reactor, AnAtMostOnceTaskThatMayHaveRunWaitsForItsWorkerOrConsent) {
  TaskPlan rollout = MakeTask("rollout");
  rollout.at_most_once = true;
  Join("a");
  const JobId job = SubmitJob({rollout});
  last_ = Do(StartRequested{"a#1", 1});
  ASSERT_EQ(Sent<GrantStart>(last_).size(), 1u);
  Pass(2.5);
  Join("b");
  last_ = Do(Tick{});
  EXPECT_TRUE(Sent<Assign>(last_).empty());
  EXPECT_EQ(Phase(job, 0), TaskPhase::kUncertain);
  Join("a", 1, {1});  // back from the dead, still running it
  EXPECT_EQ(Phase(job, 0), TaskPhase::kLeased);
  Pass(2.5);
  Do(WorkerBeat{"b#1", {}, false});
  Do(Tick{});
  EXPECT_EQ(Phase(job, 0), TaskPhase::kUncertain);
  last_ = Do(CommandJob{job, JobCommand::kRetry, "", 9});
  EXPECT_EQ(Sent<Assign>(last_).size(), 1u) << "consent";
  last_ = Do(Finished{"a#1", MakeTaskId(job, 0), 1});
  EXPECT_FALSE(Sent<AnswerResult>(last_).at(0).accepted) << "the older attempt no longer counts";
}

TEST_F(Reactor, ResultsOfAnUncertainTaskAreStillWelcome) {
  TaskPlan rollout = MakeTask("rollout");
  rollout.at_most_once = true;
  Join("a");
  const JobId job = SubmitJob({rollout});
  Do(StartRequested{"a#1", 1});
  Pass(2.5);
  Do(Tick{});
  ASSERT_EQ(Phase(job, 0), TaskPhase::kUncertain);
  last_ = Do(Finished{"a#1", MakeTaskId(job, 0), 1});
  EXPECT_TRUE(Sent<AnswerResult>(last_).at(0).accepted);
  EXPECT_EQ(Phase(job), JobPhase::kSucceeded);
}

TEST_F(Reactor, AnUncertainTaskFailsInTheEndAndSaysWhy) {
  TaskPlan rollout = MakeTask("rollout");
  rollout.at_most_once = true;
  Join("a");
  const JobId job = SubmitJob({rollout});
  Do(StartRequested{"a#1", 1});
  Pass(2.5);
  Do(Tick{});
  ns_ += state_.options.uncertain_ns + 1;
  Do(Tick{});
  EXPECT_EQ(Phase(job), JobPhase::kFailed);
  EXPECT_NE(state_.jobs.at(job).record.reason.find("may have run on a"), std::string::npos);
  last_ = Do(Finished{"a#1", MakeTaskId(job, 0), 1});
  EXPECT_FALSE(Sent<AnswerResult>(last_).at(0).accepted);
}

TEST_F(Reactor, CancelIsFinal) {
  Join("a");
  const JobId job = SubmitJob({MakeTask("t"), MakeTask("u", {{0, false}})});
  const Assign assign = Sent<Assign>(last_).at(0);
  last_ = Do(CommandJob{job, JobCommand::kCancel, "enough", 7});
  EXPECT_EQ(Sent<Revoke>(last_).size(), 1u);
  EXPECT_EQ(Sent<AnswerClient>(last_).at(0).verdict, Verdict::kOk);
  Do(Finished{"a#1", assign.task, assign.token});
  Do(CommandJob{job, JobCommand::kRetry, "", 8});
  Do(CommandJob{job, JobCommand::kResume, "", 8});
  EXPECT_EQ(Phase(job), JobPhase::kCancelled);
  EXPECT_TRUE(store_.commits.empty());
}

TEST_F(Reactor, ACancelledTaskHoldsItsSlotUntilTheWorkerSaysItStopped) {
  Join("a");
  const JobId job = SubmitJob({MakeTask("t")});
  Do(CommandJob{job, JobCommand::kCancel, "", 7});
  SubmitJob({MakeTask("next")});
  EXPECT_TRUE(Sent<Assign>(last_).empty());
  Do(WorkerBeat{"a#1", {1}, false});
  last_ = Do(WorkerBeat{"a#1", {}, false});
  EXPECT_EQ(Sent<Assign>(last_).size(), 1u);
}

TEST_F(Reactor, AFailedTaskTakesDownOnlyWhatNeedsIt) {
  Join("a", 1);
  TaskPlan bad = MakeTask("bad");
  bad.max_attempts = 1;
  const JobId job =
      SubmitJob({bad, MakeTask("needs", {{0, false}}), MakeTask("can do without", {{0, true}, {1, true}})});
  Do(Failed{"a#1", MakeTaskId(job, 0), 1, Outcome::kFailed, "no", true});
  EXPECT_EQ(Phase(job, 0), TaskPhase::kFailed);
  EXPECT_EQ(Phase(job, 1), TaskPhase::kCancelled);
  EXPECT_EQ(Phase(job, 2), TaskPhase::kLeased);
  Do(Finished{"a#1", MakeTaskId(job, 2), 2});
  EXPECT_EQ(Phase(job), JobPhase::kSucceeded);
}

TEST_F(Reactor, ACrashingTaskIsSetAsideAtItsLimitAndARetryGivesItAnotherChance) {
  Join("a");
  TaskPlan killer = MakeTask("killer");
  killer.crash_limit = 2;
  const JobId job = SubmitJob({killer, MakeTask("after", {{0, false}})});
  for (const Token token : {1, 2})
    Do(Failed{"a#1", MakeTaskId(job, 0), token, Outcome::kCrashed, "SIGSEGV", true});
  EXPECT_EQ(Phase(job), JobPhase::kFailed);
  EXPECT_TRUE(std::get<TaskFailed>(state_.jobs.at(job).tasks[0].status).set_aside);
  last_ = Do(CommandJob{job, JobCommand::kRetry, "", 7});
  ASSERT_EQ(Sent<Assign>(last_).size(), 1u);
  EXPECT_EQ(Sent<Assign>(last_)[0].attempt, 3u) << "attempts are counted on";
  Do(Finished{"a#1", MakeTaskId(job, 0), 3});
  Do(Finished{"a#1", MakeTaskId(job, 1), 4});
  EXPECT_EQ(Phase(job), JobPhase::kSucceeded);
}

TEST_F(Reactor, ATaskWhoseWorkersKeepDyingIsSetAside) {
  const JobId job = SubmitJob({MakeTask("poison")});
  for (uint32_t i = 0; i < state_.options.max_losses; ++i) {
    Join("w" + std::to_string(i));
    Do(WorkerLeft{"w" + std::to_string(i) + "#1"});
  }
  EXPECT_EQ(Phase(job), JobPhase::kFailed);
}

TEST_F(Reactor, TagsAndKindsDecideWhoMayRunATask) {
  TaskPlan task = MakeTask("rollout");
  task.required_tags = {"robot:one"};
  Join("a");
  const JobId job = SubmitJob({task});
  EXPECT_TRUE(Sent<Assign>(last_).empty());
  EXPECT_FALSE(Explain(state_, state_.jobs.at(job), 0).placeable);
  Join("b", 1, {}, {"robot:one", "gpu"});
  ASSERT_EQ(Sent<Assign>(last_).size(), 1u);
  EXPECT_EQ(Sent<Assign>(last_)[0].instance, "b#1");
}

TEST_F(Reactor, WorkGoesToTheEmptiestWorkerFirst) {
  Join("a", 4);
  Join("b", 2);
  SubmitJob({MakeTask("1"), MakeTask("2"), MakeTask("3")});
  EXPECT_EQ(state_.workers.at("a").busy(), 2u);
  EXPECT_EQ(state_.workers.at("b").busy(), 1u);
}

TEST_F(Reactor, ADrainingWorkerGetsNothingNew) {
  Join("a");
  Do(DrainWorker{"a", 5});
  SubmitJob({MakeTask("t")});
  EXPECT_TRUE(Sent<Assign>(last_).empty());
  EXPECT_NE(Explain(state_, state_.jobs.at(1), 0).reasons.at(0).find("draining"), std::string::npos);
}

TEST_F(Reactor, AWorkerThatCanRunNothingIsGivenNothingAndWhatItGivesBackCostsNoAttempt) {
  Join("a");
  SubmitJob({MakeTask("t")});
  Join("b");
  Do(WorkerBeat{"a#1", {1}, false, {}, "no process for an executor"});
  last_ = Do(Failed{"a#1", MakeTaskId(1, 0), 1, Outcome::kLost, "given back: no process for an executor", true});
  ASSERT_EQ(Sent<Assign>(last_).size(), 1u);
  EXPECT_EQ(Sent<Assign>(last_)[0].instance, "b#1");
  EXPECT_EQ(state_.jobs.at(1).tasks[0].failures, 0u);

  last_ = Do(WorkerLeft{"b#1"});
  EXPECT_TRUE(Sent<Assign>(last_).empty());
  EXPECT_NE(Explain(state_, state_.jobs.at(1), 0).reasons.at(0).find("a: no process"), std::string::npos);
  Do(WorkerBeat{"a#1", {}, false});
  EXPECT_EQ(state_.workers.at("a").leases.size(), 1u) << "it can again";
}

WorkerJoined Process(const std::string& name, int number, const std::string& key = "") {
  return {name, name + "#" + std::to_string(number), 1, {}, {"work"}, {}, false, "h", number, "v", key};
}

TEST_F(Reactor, TheSecondOfTwoLivingProcessesOfOneNameIsRefusedInOneLine) {
  Join("a");
  SubmitJob({MakeTask("t")});
  std::vector<RefuseWorker> refused;
  for (int half = 0; half < 8; ++half) {  // both speak twice per interval
    Pass(0.5);
    Do(WorkerBeat{"a#1", {1}, false});
    last_ = Do(Process("a", 2));
    EXPECT_TRUE(Sent<Welcome>(last_).empty());
    for (const RefuseWorker& m : Sent<RefuseWorker>(last_)) refused.push_back(m);
    Do(Tick{});
  }
  ASSERT_FALSE(refused.empty());
  EXPECT_EQ(refused[0].instance, "a#2");
  EXPECT_NE(refused[0].reason.find("'a' is taken by a process that is at work (host h, pid 1)"),
            std::string::npos)
      << refused[0].reason;
  EXPECT_EQ(Phase(1, 0), TaskPhase::kLeased) << "the first keeps its work";
  EXPECT_EQ(state_.workers.at("a").instance, "a#1");
}

TEST_F(Reactor, OneRobotHasOneAgentWhateverItsName) {
  const auto agent = [](const std::string& name) {
    return WorkerJoined{name, name + "#1", 1, {"robot:one"}, {"work"}, {}, false, "h", 1, "v", ""};
  };
  EXPECT_EQ(Sent<Welcome>(Do(agent("a"))).size(), 1u);
  std::vector<RefuseWorker> refused;
  for (int half = 0; half < 8; ++half) {
    Pass(0.5);
    Do(WorkerBeat{"a#1", {}, false});
    last_ = Do(agent("b"));
    EXPECT_TRUE(Sent<Welcome>(last_).empty());
    for (const RefuseWorker& m : Sent<RefuseWorker>(last_)) refused.push_back(m);
    Do(Tick{});
  }
  ASSERT_FALSE(refused.empty());
  EXPECT_NE(refused[0].reason.find("another agent, 'a', is beside this robot"), std::string::npos) << refused[0].reason;
  WorkerJoined elsewhere = agent("c");
  elsewhere.tags = {"robot:two"};
  EXPECT_EQ(Sent<Welcome>(Do(elsewhere)).size(), 1u) << "beside another robot";
  Pass(2.5);  // the first is lost
  Do(Tick{});
  EXPECT_EQ(Sent<Welcome>(Do(agent("b"))).size(), 1u);
}

TEST_F(Reactor, AProcessThatWasKilledAndStartedAgainJoinsWhenTheFirstIsKnownToBeLost) {
  Join("a");
  SubmitJob({MakeTask("t")});
  Pass(0.1);
  EXPECT_TRUE(Do(Process("a", 2)).messages.empty()) << "the first may be alive";
  Do(WorkerBeat{"a#1", {1}, false});  // was on its way when the first died
  Pass(1.2);
  EXPECT_TRUE(Do(Process("a", 2)).messages.empty());
  Pass(1.0);
  Do(Tick{});
  last_ = Do(Process("a", 2));
  ASSERT_EQ(Sent<Welcome>(last_).size(), 1u);
  ASSERT_EQ(Sent<Assign>(last_).size(), 1u);
  EXPECT_EQ(Sent<Assign>(last_)[0].instance, "a#2");
  last_ = Do(Finished{"a#1", MakeTaskId(1, 0), 1});
  EXPECT_FALSE(Sent<AnswerResult>(last_).at(0).accepted);
}

TEST_F(Reactor, AKeyEvictsNoNameOfAnotherKeyNotEvenAfterARestart) {
  Do(Process("a", 1, "anna"));
  SubmitJob({MakeTask("t")});
  const auto refusal = [&] {
    last_ = Do(Process("a", 2, "mallory"));
    EXPECT_TRUE(Sent<Welcome>(last_).empty());
    return Sent<RefuseWorker>(last_).empty() ? "" : Sent<RefuseWorker>(last_)[0].reason;
  };
  EXPECT_NE(refusal().find("another key, 'anna'"), std::string::npos);
  state_ = Restore(store_.Load(), state_.options, {ns_, 0});
  EXPECT_NE(refusal().find("another key, 'anna'"), std::string::npos) << "of a lease that may come back";
  Do(WorkerJoined{"a", "a#1", 1, {}, {"work"}, {1}, false, "h", 1, "v", "anna"});
  EXPECT_EQ(Phase(1, 0), TaskPhase::kLeased);
  Pass(2.5);
  Do(Tick{});
  EXPECT_NE(refusal().find("another key, 'anna'"), std::string::npos) << "of a worker that was just lost";
}

TEST_F(Reactor, ARolloutThatBeganIsNotBegunAgainHoweverItsAttemptEnded) {
  for (const Outcome outcome :
       {Outcome::kLost, Outcome::kCancelled, Outcome::kFailed, Outcome::kCrashed, Outcome::kTimedOut}) {
    TaskPlan rollout = MakeTask("rollout");
    rollout.at_most_once = true;
    const std::string name = "w" + std::to_string(static_cast<int>(outcome));
    Join(name);
    const JobId job = SubmitJob({rollout});
    const Assign assign = Sent<Assign>(last_).at(0);
    Do(StartRequested{assign.instance, assign.token});
    last_ = Do(Failed{assign.instance, assign.task, assign.token, outcome, "over", true});
    EXPECT_TRUE(Sent<Assign>(last_).empty()) << name;
    EXPECT_EQ(Phase(job), JobPhase::kFailed) << name;
    EXPECT_NE(state_.jobs.at(job).record.reason.find("`retry` lets it run again"), std::string::npos);
    last_ = Do(CommandJob{job, JobCommand::kRetry, "", 9});
    EXPECT_EQ(Sent<Assign>(last_).size(), 1u) << "with consent";
    Do(CommandJob{job, JobCommand::kCancel, "", 9});
    Do(WorkerLeft{assign.instance});
  }
}

TEST_F(Reactor, ARolloutThatWasGivenBackBeforeItBeganGoesToAnother) {
  TaskPlan rollout = MakeTask("rollout");
  rollout.at_most_once = true;
  Join("a");
  SubmitJob({rollout});
  last_ = Do(Failed{"a#1", MakeTaskId(1, 0), 1, Outcome::kLost, "given back: its worker is draining", true});
  EXPECT_EQ(Sent<Assign>(last_).size(), 1u);
}

TEST_F(Reactor, ARequestIdStandsForOneContent) {
  const auto submit = [&](const std::string& content) {
    auto plan = std::make_shared<JobPlan>(*MakePlan({MakeTask("t")}));
    plan->content = content;
    return Sent<AnswerClient>(Do(Submit{"same", plan, nullptr, 1, 0, content})).at(0);
  };
  const AnswerClient first = submit("abc");
  EXPECT_EQ(submit("abc").job, first.job);
  state_ = Restore(store_.Load(), state_.options, {ns_, 0});
  const AnswerClient other = submit("abd");
  EXPECT_EQ(other.verdict, Verdict::kFailedPrecondition);
  EXPECT_NE(other.error.find("was used for job 1, which asked for something else"), std::string::npos);
  EXPECT_EQ(state_.jobs.size(), 1u);
}

TEST_F(Reactor, ABatchThatCameToNothingCostsNoWorkerAndNoLease) {
  Join("a", 2);
  SubmitJob({MakeTask("t"), MakeTask("u", {{0, false}})});
  State before = state_;
  On(Finished{"a#1", MakeTaskId(1, 0), 1}, state_, {ns_, 0});  // its rows are not kept
  State after = Restore(store_.Load(), state_.options, {ns_, 0});
  KeepWorkers(state_, after, {ns_, 0});
  state_ = std::move(after);
  for (const std::string& line : BrokenInvariants(state_)) ADD_FAILURE() << line;
  EXPECT_EQ(Phase(1, 0), TaskPhase::kLeased);
  EXPECT_TRUE(state_.workers.at("a").connected);
  EXPECT_EQ(state_.workers.at("a").leases, std::set<Token>{1});
  last_ = Do(Finished{"a#1", MakeTaskId(1, 0), 1});
  EXPECT_TRUE(Sent<AnswerResult>(last_).at(0).accepted);
  EXPECT_EQ(Sent<Assign>(last_).size(), 1u) << "the child";
}

TEST_F(Reactor, MessagesFromNobodyAndAboutNothingDoNoHarm) {
  SubmitJob({MakeTask("t")});
  Do(Finished{"ghost", 0, 99});
  Do(Finished{"ghost", MakeTaskId(77, 3), 99});
  Do(Failed{"ghost", -1, 99, Outcome::kCrashed, "", true});
  Do(Progressed{"ghost", 99, "", 0, 0, ""});
  Do(StartRequested{"ghost", 99});
  Do(WorkerBeat{"ghost", {1, 2, 3}, true});
  Do(WorkerLeft{"ghost"});
  Do(CommandJob{77, JobCommand::kCancel, "", 1});
  EXPECT_EQ(Phase(1), JobPhase::kQueued);
}

TEST_F(Reactor, ShortTasksAreGivenAheadOfAFreeSlotAndLongOnesAreNot) {
  Join("a", 1);
  SubmitJob(std::vector<TaskPlan>(40, MakeTask("t")));
  std::vector<Assign> assigned = Sent<Assign>(last_);
  ASSERT_EQ(assigned.size(), 1u) << "nobody knows how long they take";
  assigned = Sent<Assign>(Do(Finished{"a#1", assigned[0].task, assigned[0].token, 0.004}));
  EXPECT_EQ(assigned.size(), 1u + 5u) << "a slot's worth and 20 ms of work";
  Join("b", 1);
  EXPECT_EQ(Sent<Assign>(last_).size(), 6u);
  assigned = Sent<Assign>(Do(Finished{"a#1", assigned[0].task, assigned[0].token, 3.0}));
  EXPECT_TRUE(assigned.empty()) << "one took long: what is there will do";
}

// By the clock of two workers that take half a second for each: what they have at hand, first one first.
TEST_F(Reactor, OneOfTheTasksBelowASecondIsAtHandWhileThereAreManyAndNoneWaitsAtTheEnd) {
  Join("a", 1), Join("b", 1);
  constexpr uint32_t kTasks = 12;
  SubmitJob(std::vector<TaskPlan>(kTasks, MakeTask("t")));
  std::map<std::string, std::deque<Assign>> at;
  uint32_t ahead = 0, done = 0;
  const auto take = [&](const Actions& actions) {
    for (const Assign& assign : Sent<Assign>(actions)) {
      const bool has_work = !at[assign.instance].empty();
      ahead += has_work;
      EXPECT_FALSE(has_work && IndexOf(assign.task) >= kTasks - 2) << "one of the last two waits behind another";
      at[assign.instance].push_back(assign);
    }
  };
  take(last_);
  EXPECT_EQ(ahead, 0u) << "nobody knows how long they take";
  for (; done < kTasks; ++done) {
    const std::string worker = at[done % 2 == 0 ? "a#1" : "b#1"].empty() ? "b#1" : done % 2 == 0 ? "a#1" : "b#1";
    ASSERT_FALSE(at[worker].empty()) << "it has nothing to do after " << done;
    const Assign first = at[worker].front();
    at[worker].pop_front();
    take(Do(Finished{worker, first.task, first.token, 0.5}));
  }
  EXPECT_GE(ahead, kTasks - 6) << "but for the first two and the last ones";
  EXPECT_EQ(Phase(1), JobPhase::kSucceeded);
}

TEST_F(Reactor, ATaskThatWaitedBehindAnotherGoesBackWithoutPenalty) {
  Join("a", 1);
  const JobId job = SubmitJob(std::vector<TaskPlan>(3, MakeTask("t")));
  Assign first = Sent<Assign>(last_).at(0);
  const auto more = Sent<Assign>(Do(Finished{"a#1", first.task, first.token, 0.001}));
  ASSERT_EQ(more.size(), 2u);
  Join("b", 1);
  const auto actions = Do(Failed{"a#1", more[1].task, more[1].token, Outcome::kLost, "it waited", true});
  const auto moved = Sent<Assign>(actions);
  ASSERT_EQ(moved.size(), 1u);
  EXPECT_EQ(moved[0].instance, "b#1");
  EXPECT_EQ(state_.jobs.at(job).tasks[2].failures, 0u);
  EXPECT_EQ(state_.jobs.at(job).tasks[2].losses, 0u);
}

TEST_F(Reactor, AWorkerOnWhichEverythingFailsFailsNoJobWhileThereIsAnother) {
  Join("ill", 2), Join("well", 1);
  const JobId job = SubmitJob(std::vector<TaskPlan>(20, MakeTask("t")));
  std::deque<Assign> open;
  const auto take = [&](const Actions& actions) {
    for (const Assign& assign : Sent<Assign>(actions)) open.push_back(assign);
  };
  take(last_);
  for (int i = 0; i < 200 && !open.empty(); ++i) {
    // The ill one fails at once, the other one takes its time.
    const auto at_ill = std::find_if(open.begin(), open.end(), [](const Assign& a) { return a.instance == "ill#1"; });
    const auto next = at_ill != open.end() ? at_ill : open.begin();
    const Assign assign = *next;
    open.erase(next);
    take(assign.instance == "ill#1"
             ? Do(Failed{"ill#1", assign.task, assign.token, Outcome::kFailed, "disk full", true})
             : Do(Finished{"well#1", assign.task, assign.token, 5.0}));
  }
  EXPECT_EQ(Phase(job), JobPhase::kSucceeded);
  EXPECT_EQ(state_.jobs.at(job).failed_on.size(), 0u);
  for (uint32_t i = 0; i < 20; ++i) EXPECT_LE(state_.jobs.at(job).tasks[i].failures, 1u) << i;
}

TEST_F(Reactor, ATaskThatFailedIsTriedAgainWhereItFailedIfThereIsNobodyElse) {
  Join("a", 1);
  SubmitJob({MakeTask("t")});
  const Assign first = Sent<Assign>(last_).at(0);
  const auto fail = [&](const Assign& a) {
    return Sent<Assign>(Do(Failed{"a#1", a.task, a.token, Outcome::kFailed, "no", true}));
  };
  const auto again = fail(first);
  ASSERT_EQ(again.size(), 1u);
  Join("b", 1);
  const auto third = fail(again[0]);
  ASSERT_EQ(third.size(), 1u);
  EXPECT_EQ(third[0].instance, "b#1");
}

TEST_F(Reactor, WhatMustNotRunTwiceIsNeverGivenAhead) {
  Join("a", 1);
  TaskPlan once = MakeTask("once");
  once.at_most_once = true;
  SubmitJob({once, once, once});
  const Assign first = Sent<Assign>(last_).at(0);
  EXPECT_EQ(Sent<Assign>(Do(Finished{"a#1", first.task, first.token, 0.001})).size(), 1u);
}

TEST_F(Reactor, AJobThatLeftMemoryLeavesNothingBehind) {
  Join("a", 1);
  TaskPlan tagged = MakeTask("t");
  tagged.required_tags = {"rare"};
  Join("b", 1, {}, {"rare"});
  SubmitJob({tagged});
  const Assign task = Sent<Assign>(last_).at(0);
  Do(Finished{task.instance, task.task, task.token});
  ASSERT_EQ(state_.ended, std::vector<JobId>{1});
  Retire(state_, 1);
  EXPECT_TRUE(state_.jobs.empty());
  EXPECT_TRUE(state_.job_by_request.empty());
  EXPECT_TRUE(state_.class_index.empty());
  EXPECT_TRUE(state_.workers.at("b").classes.empty());
  EXPECT_TRUE(BrokenInvariants(state_).empty());
  SubmitJob({MakeTask("t")});
  EXPECT_EQ(state_.classes.size(), 1u) << "its place is taken again";
  // Its request is still known, and the last word of its task too: the shell looks them up.
  Submit again{"r1", MakePlan({tagged}), nullptr, 1};
  again.known = 1;
  EXPECT_TRUE(Sent<AnswerClient>(Do(again)).at(0).already_known);
  Finished repeat{task.instance, task.task, task.token};
  EXPECT_FALSE(Sent<AnswerResult>(Do(repeat)).at(0).accepted);
  repeat.committed = task.token;
  EXPECT_TRUE(Sent<AnswerResult>(Do(repeat)).at(0).accepted);
}

TEST_F(Reactor, AWorkerOfNoKindIsNotOfferedWhatTakesAFreePlace) {
  Join("a", 1);
  SubmitJob({MakeTask("t")});
  const Assign task = Sent<Assign>(last_).at(0);
  Do(Finished{"a#1", task.task, task.token});
  Retire(state_, 1);
  Do(WorkerJoined{"b", "b#1", 1, {}, {""}, {}, false, "h", 1, "v", ""});
  Do(WorkerLeft{"a#1"});
  SubmitJob({MakeTask("t")});
  EXPECT_TRUE(Sent<Assign>(last_).empty());
}

}  // namespace
}  // namespace rg::coordinator
