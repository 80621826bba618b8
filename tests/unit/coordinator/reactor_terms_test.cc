// Priorities that change, jobs after others, time limits: step by step, the promises checked after each event.
#include <gtest/gtest.h>

#include "tests/unit/coordinator/reactor_fixture.h"

namespace rg::coordinator {
namespace {

class JobTerms : public ReactorTest {
 protected:
  JobId SubmitAfter(const std::vector<JobId>& before, JobId unmet = 0) {
    auto plan = std::make_shared<JobPlan>(*MakePlan({MakeTask("t")}));
    plan->after_jobs = before;
    Submit submit{"r" + std::to_string(++requests_), plan, nullptr, 1};
    submit.unmet = unmet;
    last_ = Do(submit);
    return Sent<AnswerClient>(last_).at(0).job;
  }
  JobId SubmitLimited(double seconds) {
    auto plan = std::make_shared<JobPlan>(*MakePlan({MakeTask("t"), MakeTask("u")}));
    plan->time_limit_ns = static_cast<int64_t>(1e9 * seconds);
    last_ = Do(Submit{"r" + std::to_string(++requests_), plan, nullptr, 1});
    return state_.last_job;
  }
  AnswerClient Command(JobId job, JobCommand command, int32_t priority = 0) {
    CommandJob event{job, command, "", 7};
    event.priority = priority;
    last_ = Do(event);
    return Sent<AnswerClient>(last_).at(0);
  }
  // Ends the task of the newest assignment with this outcome.
  void End(const Assign& assign, bool well) {
    if (well) {
      last_ = Do(Finished{"a#1", assign.task, assign.token});
    } else {
      last_ = Do(Failed{"a#1", assign.task, assign.token, Outcome::kFailed, "no", false});
    }
  }
};

TEST_F(JobTerms, AJobStartsWhenAllThatItComesAfterSucceeded) {
  Join("a", 4);
  const JobId first = SubmitJob({MakeTask("t")});
  const Assign one = Sent<Assign>(last_).at(0);
  const JobId second = SubmitJob({MakeTask("t")});
  const Assign two = Sent<Assign>(last_).at(0);
  const JobId third = SubmitAfter({first, second});
  EXPECT_TRUE(Sent<Assign>(last_).empty());
  EXPECT_EQ(Phase(third), JobPhase::kQueued);
  End(one, true);
  EXPECT_TRUE(Sent<Assign>(last_).empty()) << "the other one runs still";
  const std::vector<std::string> why = Explain(state_, state_.jobs.at(third), 0).reasons;
  EXPECT_EQ(why, std::vector<std::string>{"its job comes after 2, which is not over"});
  End(two, true);
  ASSERT_EQ(Sent<Assign>(last_).size(), 1u);
  EXPECT_EQ(JobOf(Sent<Assign>(last_)[0].task), third);
}

TEST_F(JobTerms, AFailureGoesDownALongLineOfJobsAndRetriesGoTheSameWay) {
  Join("a", 4);
  SubmitJob({MakeTask("t")});
  const Assign one = Sent<Assign>(last_).at(0);
  constexpr JobId kLine = 300;
  for (JobId id = 2; id <= kLine; ++id) ASSERT_EQ(SubmitAfter({id - 1}), id);
  End(one, false);
  for (JobId id = 1; id <= kLine; ++id) EXPECT_EQ(Phase(id), JobPhase::kFailed) << id;
  EXPECT_EQ(state_.jobs.at(3).record.reason, "job 2 is failed, and this one comes after it");
  EXPECT_EQ(Command(3, JobCommand::kRetry).verdict, Verdict::kFailedPrecondition);
  EXPECT_EQ(Command(1, JobCommand::kRetry).verdict, Verdict::kOk);
  const Assign again = Sent<Assign>(last_).at(0);
  EXPECT_EQ(Command(2, JobCommand::kRetry).verdict, Verdict::kOk);
  EXPECT_TRUE(Sent<Assign>(last_).empty()) << "it waits again";
  End(again, true);
  ASSERT_EQ(Sent<Assign>(last_).size(), 1u);
  EXPECT_EQ(JobOf(Sent<Assign>(last_)[0].task), 2);
}

TEST_F(JobTerms, NothingComesAfterWhatFailed) {
  Join("a", 4);
  SubmitJob({MakeTask("t")});
  End(Sent<Assign>(last_).at(0), false);
  EXPECT_EQ(SubmitAfter({1}), 0);
  EXPECT_EQ(Sent<AnswerClient>(last_).at(0).verdict, Verdict::kFailedPrecondition);
  EXPECT_EQ(SubmitAfter({9}, 9), 0) << "as the shell said of one that left memory";
  Do(CommandJob{1, JobCommand::kCancel, "", 0});
}

TEST_F(JobTerms, CancellingWhatOthersWaitForAndPausingWhatWaits) {
  Join("a", 1);
  const JobId first = SubmitJob({MakeTask("t")});
  const Assign one = Sent<Assign>(last_).at(0);
  const JobId second = SubmitAfter({first}), third = SubmitAfter({first});
  EXPECT_EQ(Command(second, JobCommand::kPause).verdict, Verdict::kOk);
  EXPECT_EQ(Command(third, JobCommand::kCancel).verdict, Verdict::kOk);
  End(one, true);
  EXPECT_TRUE(Sent<Assign>(last_).empty()) << "it is paused";
  EXPECT_EQ(Command(second, JobCommand::kResume).verdict, Verdict::kOk);
  EXPECT_EQ(Sent<Assign>(last_).size(), 1u);
}

TEST_F(JobTerms, PriorityChangedLaterDecidesWhoIsNextAndReachesWhatTasksSubmitted) {
  Join("a", 1);
  SubmitJob({MakeTask("lead")});
  const Assign lead = Sent<Assign>(last_).at(0);
  auto part = std::make_shared<JobPlan>(*MakePlan({MakeTask("part")}));
  part->parent = lead.task;
  const JobId child = Sent<AnswerClient>(Do(Submit{"part", part, nullptr, 1, lead.token})).at(0).job;
  const JobId other = SubmitJob({MakeTask("t")}, 5);
  EXPECT_EQ(Command(1, JobCommand::kPriority, 9).verdict, Verdict::kOk);
  EXPECT_EQ(state_.jobs.at(child).priority_of(0), 9);
  Join("b", 1);
  EXPECT_EQ(JobOf(Sent<Assign>(last_).at(0).task), child) << "9 is before 5";
  EXPECT_EQ(Phase(other, 0), TaskPhase::kReady);
  EXPECT_EQ(Command(other, JobCommand::kPriority, -3).verdict, Verdict::kOk);
  EXPECT_EQ(state_.jobs.at(other).priority_of(0), -3);
  EXPECT_EQ(Command(other, JobCommand::kCancel).verdict, Verdict::kOk);
  EXPECT_EQ(Command(other, JobCommand::kPriority, 1).verdict, Verdict::kFailedPrecondition);
}

TEST_F(JobTerms, ATimeLimitCountsFromTheStartOnTheSteadyClockAndOverRestarts) {
  const JobId job = SubmitLimited(60.0);
  ns_ += 100'000'000'000;
  Do(Tick{});
  EXPECT_EQ(Phase(job), JobPhase::kQueued) << "it has not started";
  Join("a", 2);
  const std::vector<Assign> assigned = Sent<Assign>(last_);
  const auto beat = [&](double seconds) {
    ns_ += static_cast<int64_t>(1e9 * seconds);
    Do(WorkerBeat{"a#1", {assigned[0].token, assigned[1].token}, false});
    last_ = Do(Tick{});
  };
  for (int i = 0; i < 29; ++i) beat(2.0);
  EXPECT_EQ(Phase(job), JobPhase::kRunning);
  // A wall clock that was set back by a day, and one set forward, as a restart sees them.
  const int64_t day_ns = 86'400'000'000'000;
  const auto left_after = [&](int64_t jump_ns) {
    const State later = Restore(store_.Load(), state_.options, {ns_, 1'000 + ns_ + jump_ns});
    return later.jobs.at(job).deadline_ns - ns_;
  };
  EXPECT_EQ(left_after(0), 2'000'000'000);
  EXPECT_EQ(left_after(-day_ns), 60'000'000'000) << "never more than the limit";
  EXPECT_EQ(left_after(day_ns), 0);
  beat(2.5);
  EXPECT_EQ(Phase(job), JobPhase::kRunning) << "this heartbeat may have been on its way before the limit";
  beat(2.0);
  EXPECT_EQ(Phase(job), JobPhase::kFailed);
  EXPECT_EQ(state_.jobs.at(job).record.reason, "its time limit of 60 s is over");
  EXPECT_EQ(Sent<Revoke>(last_).size(), 2u);
  EXPECT_EQ(Command(job, JobCommand::kRetry).verdict, Verdict::kOk);
  EXPECT_EQ(state_.jobs.at(job).deadline_ns, ns_ + 60'000'000'000) << "a retry has the whole limit again";
}

// A job of two tasks, the second after the first, with a limit of a minute; the first has been running since.
class TimeLimit : public JobTerms {
 protected:
  void Begin() {
    TaskPlan second = MakeTask("second");
    second.parents = {{0, false}};
    auto plan = std::make_shared<JobPlan>(*MakePlan({MakeTask("first"), second}));
    plan->time_limit_ns = 60'000'000'000;
    Join("a", 1);
    last_ = Do(Submit{"limited", plan, nullptr, 1});
    first_ = Sent<Assign>(last_).at(0);
    start_ns_ = ns_;
  }
  // To this many seconds after the start; the coordinator and the worker are well on the way.
  void GoTo(double seconds) {
    while (ns_ < start_ns_ + static_cast<int64_t>(1e9 * seconds)) {
      Pass(0.5);
      Beat(false);
    }
  }
  void Beat(bool finished) {
    WorkerBeat beat{"a#1", {first_.token}, false};
    if (finished) beat.finished = {first_.token};
    Do(beat);
    last_ = Do(Tick{});
  }
  // The coordinator is killed now and comes back at this moment, and so does the worker.
  void BeAwayUntil(double seconds) {
    ns_ = start_ns_ + static_cast<int64_t>(1e9 * seconds);
    state_ = Restore(store_.Load(), state_.options, {ns_, 1'000 + ns_});
    last_ = Do(Tick{});
    Join("a", 1, {first_.token});
  }
  AnswerResult Finish() {
    last_ = Do(Finished{"a#1", first_.task, first_.token});
    return Sent<AnswerResult>(last_).at(0);
  }

  Assign first_;
  int64_t start_ns_ = 0;
};

TEST_F(TimeLimit, WhatWasFinishedWhileTheCoordinatorWasAwayCountsAndNothingElseBegins) {
  Begin();
  GoTo(30.0);
  BeAwayUntil(90.0);
  EXPECT_EQ(Phase(1), JobPhase::kRunning) << "who holds something of it has not said yet how far it is";
  Pass(1.5);
  Beat(true);
  EXPECT_EQ(Phase(1), JobPhase::kRunning);
  const std::vector<std::string> why = Explain(state_, state_.jobs.at(1), 1).reasons;
  EXPECT_EQ(why.at(0), "the time limit of its job is over");
  EXPECT_TRUE(Finish().accepted);
  EXPECT_EQ(Phase(1, 0), TaskPhase::kSucceeded);
  EXPECT_TRUE(Sent<Assign>(last_).empty()) << "its limit is over";
  Do(Tick{});
  EXPECT_EQ(Phase(1), JobPhase::kFailed);
  EXPECT_EQ(Command(1, JobCommand::kRetry).verdict, Verdict::kOk);
  EXPECT_EQ(IndexOf(Sent<Assign>(last_).at(0).task), 1u) << "what counted is not done again";
}

TEST_F(TimeLimit, AJobWhoseLastResultWasFinishedInTimeSucceeds) {
  Begin();
  ASSERT_TRUE(Finish().accepted);
  first_ = Sent<Assign>(last_).at(0);
  GoTo(59.0);
  for (int i = 0; i < 30; ++i) {  // a minute for its outputs to be brought here
    Pass(1.0);
    Beat(true);
  }
  EXPECT_EQ(Phase(1), JobPhase::kRunning);
  EXPECT_TRUE(Finish().accepted);
  EXPECT_EQ(Phase(1), JobPhase::kSucceeded);
}

TEST_F(TimeLimit, WhatStillRunsAfterAnAbsenceIsStopped) {
  Begin();
  GoTo(30.0);
  BeAwayUntil(90.0);
  Beat(false);
  Pass(1.5);
  Beat(false);
  EXPECT_EQ(Phase(1), JobPhase::kFailed);
  EXPECT_EQ(Sent<Revoke>(last_).size(), 1u);
  EXPECT_FALSE(Finish().accepted);
}

TEST_F(TimeLimit, AWorkerThatIsLostKeepsNoJobBeyondItsLimit) {
  Begin();
  GoTo(60.0);
  Beat(true);
  Pass(3.0);
  Do(Tick{});
  EXPECT_EQ(Phase(1), JobPhase::kFailed);
  EXPECT_EQ(state_.jobs.at(1).record.reason, "its time limit of 60 s is over");
}

TEST_F(TimeLimit, NothingOfAJobStartsAfterARestartBeyondItsLimit) {
  Begin();
  Do(WorkerLeft{"a#1"});
  ns_ += 90'000'000'000;
  state_ = Restore(store_.Load(), state_.options, {ns_, 1'000 + ns_});
  Join("b", 1);
  EXPECT_TRUE(Sent<Assign>(last_).empty());
  Do(Tick{});
  EXPECT_EQ(Phase(1), JobPhase::kFailed);
}

}  // namespace
}  // namespace rg::coordinator
