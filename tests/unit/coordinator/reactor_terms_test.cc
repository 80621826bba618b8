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
  EXPECT_EQ(Phase(job), JobPhase::kFailed);
  EXPECT_EQ(state_.jobs.at(job).record.reason, "its time limit of 60 s is over");
  EXPECT_EQ(Sent<Revoke>(last_).size(), 2u);
  EXPECT_EQ(Command(job, JobCommand::kRetry).verdict, Verdict::kOk);
  EXPECT_EQ(state_.jobs.at(job).deadline_ns, ns_ + 60'000'000'000) << "a retry has the whole limit again";
}

}  // namespace
}  // namespace rg::coordinator
