// How many allocations to have: the plan over time, without a cluster.
#include <gtest/gtest.h>

#include <filesystem>

#include "common/base/file.h"
#include "common/base/ids.h"
#include "coordinator/autoscale/autoscaler.h"
#include "coordinator/autoscale/command.h"
#include "coordinator/autoscale/plan.h"
#include "coordinator/autoscale/slurm.h"

namespace rg::coordinator::autoscale {
namespace {

constexpr char kPrefix[] = "rg-";
constexpr int64_t kSecond = 1'000'000'000;

// A cluster and a coordinator as the plan sees them, one step a second.
class AutoscalePlan : public ::testing::Test {
 protected:
  Actions Step(int seconds = 1) {
    seen_.now_ns += seconds * kSecond;
    Actions actions = Plan(kPrefix, limits_, seen_, state_);
    if (actions.ask) asked_.push_back(*actions.ask);
    for (const auto& id : actions.give_back) given_back_.push_back(id);
    return actions;
  }
  // What the last tag that was asked for became.
  void Answer(const std::string& id, bool pending) {
    NoteAsked(asked_.back(), id, state_);
    seen_.cluster->push_back({asked_.back(), id, pending, false});
  }
  void Join(const std::string& name, bool busy) {
    seen_.workers.push_back({name, limits_.slots, busy, false, 0});
  }

  Limits limits_;
  State state_;
  Seen seen_{1000 * kSecond, 0, {}, std::vector<Listed>()};
  std::vector<std::string> asked_, given_back_;
};

TEST_F(AutoscalePlan, AsksForNothingWithoutWork) {
  for (int i = 0; i < 10; ++i) Step();
  EXPECT_TRUE(asked_.empty());
}

TEST_F(AutoscalePlan, AsksForOneAtATimeUntilThereAreEnough) {
  seen_.slots_wanted = 5;
  limits_.slots = 2;
  for (int i = 0; i < 3; ++i) {
    Step();
    ASSERT_EQ(asked_.size(), static_cast<size_t>(i + 1));
    Step();  // the answer is not there: it is asked for once
    Answer(std::to_string(10 + i), true);
    Step();
    ASSERT_EQ(asked_.size(), static_cast<size_t>(i + 1)) << "one pends";
    seen_.cluster->back().pending = false;
    Join(asked_.back(), true);
  }
  for (int i = 0; i < 10; ++i) Step();
  EXPECT_EQ(asked_.size(), 3u) << "three workers of two slots do for five tasks";
  EXPECT_TRUE(given_back_.empty());
}

TEST_F(AutoscalePlan, WorkersOfOthersCount) {
  seen_.slots_wanted = 4;
  seen_.workers.push_back({"mine", 4, true, false, 0});
  Step();
  EXPECT_TRUE(asked_.empty());
  seen_.workers[0].draining = true;
  Step();
  EXPECT_EQ(asked_.size(), 1u);
}

TEST_F(AutoscalePlan, TheLimitHolds) {
  limits_.max_allocations = 2;
  seen_.slots_wanted = 100;
  for (int i = 0; i < 10; ++i) {
    if (Step().ask) {
      Answer(std::to_string(i), false);
      Join(asked_.back(), true);
    }
  }
  EXPECT_EQ(asked_.size(), 2u);
}

TEST_F(AutoscalePlan, WhatIsNoLongerWantedIsGivenBackAfterAMoment) {
  seen_.slots_wanted = 1;
  Step();
  Answer("7", true);
  Step();
  seen_.slots_wanted = 0;
  Step();
  EXPECT_TRUE(given_back_.empty());
  Step(20);
  EXPECT_EQ(given_back_, std::vector<std::string>{"7"});
  seen_.cluster->clear();
  Step(), Step();
  EXPECT_TRUE(state_.allocations.empty());
  EXPECT_EQ(state_.in_vain, 0);
}

TEST_F(AutoscalePlan, AnAskingWhoseAnswerWasLostIsFoundAgain) {
  seen_.slots_wanted = 1;
  Step();
  ASSERT_EQ(asked_.size(), 1u);
  for (int i = 0; i < 5; ++i) Step();
  seen_.cluster->push_back({asked_[0], "12", true, false});
  for (int i = 0; i < 50; ++i) Step();
  EXPECT_EQ(asked_.size(), 1u);
  ASSERT_EQ(state_.allocations.size(), 1u);
  EXPECT_EQ(state_.allocations[0].id, "12");
}

TEST_F(AutoscalePlan, AnAskingThatTheClusterNeverKnewIsGivenUpAndWhatComesLateIsGivenBack) {
  seen_.slots_wanted = 1;
  Step();
  for (int i = 0; i < 40; ++i) Step();
  ASSERT_EQ(asked_.size(), 2u);
  EXPECT_NE(asked_[0], asked_[1]) << "never the same name";
  seen_.cluster->push_back({asked_[0], "3", false, false});
  Step();
  EXPECT_EQ(given_back_, std::vector<std::string>{"3"});
}

TEST_F(AutoscalePlan, AClusterThatDoesNotAnswerIsNotAskedAndForgetsNothing) {
  seen_.slots_wanted = 3;
  Step();
  Answer("1", false);
  Join(asked_.back(), true);
  Step();
  const size_t asked = asked_.size();
  seen_.cluster.reset();
  for (int i = 0; i < 100; ++i) Step(10);
  EXPECT_EQ(asked_.size(), asked);
  EXPECT_EQ(state_.allocations.size(), asked);
}

TEST_F(AutoscalePlan, AConnectedWorkerIsAliveWhateverTheClusterSays) {
  seen_.slots_wanted = 1;
  Step();
  Answer("1", false);
  Join(asked_.back(), true);
  Step();
  seen_.cluster->clear();  // its controller was killed and has lost the job
  for (int i = 0; i < 20; ++i) Step();
  EXPECT_EQ(asked_.size(), 1u);
  EXPECT_EQ(state_.allocations.size(), 1u);
}

TEST_F(AutoscalePlan, AllocationsInVainWaitLongerAndLongerUntilItPauses) {
  seen_.slots_wanted = 1;
  std::vector<int64_t> at;
  for (int minute = 0; minute < 60 * 24; ++minute) {
    for (int second = 0; second < 60; second += 10) {
      if (!Step(10).ask) continue;
      at.push_back(seen_.now_ns);
      NoteAsked(asked_.back(), std::to_string(at.size()), state_);
    }
  }
  ASSERT_EQ(at.size(), 6u);
  EXPECT_TRUE(state_.paused);
  const auto minutes = [&](size_t i) { return static_cast<double>(at[i] - at[i - 1]) / (60.0 * kSecond); };
  EXPECT_LT(minutes(1), 1.0);
  EXPECT_NEAR(minutes(2), 1.0, 1.0);
  EXPECT_NEAR(minutes(3), 15.0, 1.0);
  EXPECT_NEAR(minutes(4), 30.0, 1.0);
  EXPECT_NEAR(minutes(5), 60.0, 1.0);
}

TEST_F(AutoscalePlan, WorkDoneForgetsWhatWasInVain) {
  seen_.slots_wanted = 1;
  for (int i = 0; i < 3; ++i) {
    Step();
    NoteAsked(asked_.back(), "1", state_);
    Step(), Step();
  }
  EXPECT_GT(state_.in_vain, 0);
  Step(3600);
  Answer("9", false);
  Join(asked_.back(), true);
  Step();
  EXPECT_EQ(state_.in_vain, 0);
}

TEST_F(AutoscalePlan, OneThatRunsWithoutItsWorkerIsGivenBack) {
  seen_.slots_wanted = 1;
  Step();
  Answer("4", false);
  Step();
  EXPECT_TRUE(given_back_.empty());
  Step(1), Step(301);
  EXPECT_EQ(given_back_, std::vector<std::string>{"4"});
  EXPECT_EQ(state_.in_vain, 1);
}

TEST(AllocationFile, ComesBackAsItWas) {
  const std::string path = "/tmp/rg-allocations-" + RandomHex(6);
  auto stored = LoadOrMake(path);
  ASSERT_TRUE(stored.ok());
  Allocation a;
  a.tag = stored->prefix + "1", a.id = "17", a.phase = Phase::kRunning, a.joined = true, a.asked_ns = 5;
  stored->state.allocations.push_back(a);
  stored->state.next = 2;
  ASSERT_TRUE(Save(path, *stored).ok());
  const auto again = LoadOrMake(path);
  ASSERT_TRUE(again.ok());
  EXPECT_EQ(again->prefix, stored->prefix);
  EXPECT_EQ(again->state.next, 2);
  ASSERT_EQ(again->state.allocations.size(), 1u);
  EXPECT_EQ(again->state.allocations[0].id, "17");
  EXPECT_EQ(again->state.allocations[0].phase, Phase::kRunning);
  ASSERT_TRUE(WriteFileAtomically(path, "{").ok());
  EXPECT_EQ(LoadOrMake(path).status().code(), StatusCode::kInvalid);
  std::filesystem::remove(path);
}

TEST(Command, EndsOrIsEnded) {
  const auto said = RunCommand({"sh", "-c", "cat; echo error >&2; exit 3"}, "in", 30.0);
  ASSERT_TRUE(said.ok());
  EXPECT_EQ(said->code, 3);
  EXPECT_EQ(said->out, "in");
  EXPECT_EQ(said->err, "error\n");
  EXPECT_EQ(RunCommand({"sleep", "600"}, "", 0.2).status().code(), StatusCode::kDeadlineExceeded);
  EXPECT_EQ(RunCommand({"rg-no-such-program"}, "", 1.0).status().code(), StatusCode::kUnavailable);
}

TEST(Command, QuotesForAShell) {
  const auto said = RunCommand({"sh", "-c", "printf %s " + ShellQuoted("a'b \"$HOME\"`id`\\")}, "", 30.0);
  EXPECT_EQ(said->out, "a'b \"$HOME\"`id`\\");
}

TEST(Queue, IsRead) {
  const auto all = ParseQueue("1|rg-1|PENDING\n2|rg-2|RUNNING\n3|a|b|COMPLETED\n4|rg-4|COMPLETING\n");
  ASSERT_TRUE(all.ok());
  ASSERT_EQ(all->size(), 4u);
  EXPECT_TRUE((*all)[0].pending);
  EXPECT_FALSE((*all)[1].pending || (*all)[1].ended);
  EXPECT_EQ((*all)[2].tag, "a|b");
  EXPECT_TRUE((*all)[2].ended);
  EXPECT_FALSE((*all)[3].ended);
  EXPECT_FALSE(ParseQueue("slurm_load_jobs error\n").ok());
}

TEST(AllocationLogs, TheNewestAndThoseOfLivingAllocationsStay) {
  namespace fs = std::filesystem;
  const fs::path folder = fs::temp_directory_path() / ("rg-logs-" + RandomHex(6));
  fs::create_directories(folder);
  const auto now = fs::file_time_type::clock::now();
  for (int hours = 0; hours < 6; ++hours) {
    const fs::path log = folder / ("rg-" + std::to_string(hours) + ".log");
    ASSERT_TRUE(WriteFileAtomically(log.string(), "x").ok());
    fs::last_write_time(log, now - std::chrono::hours(hours));
  }
  ASSERT_TRUE(WriteFileAtomically((folder / "notes.txt").string(), "x").ok());
  const auto left = [&] {
    std::string names;
    for (int hours = 0; hours < 6; ++hours)
      if (fs::exists(folder / ("rg-" + std::to_string(hours) + ".log"))) names += std::to_string(hours);
    return names;
  };
  EXPECT_EQ(PruneLogs(folder.string(), {"rg-5"}, 3, 1e6), 2u);
  EXPECT_EQ(left(), "0125");
  EXPECT_EQ(PruneLogs(folder.string(), {"rg-5"}, 3, 5000.0), 1u);
  EXPECT_EQ(left(), "015");
  EXPECT_TRUE(fs::exists(folder / "notes.txt"));
  EXPECT_EQ(PruneLogs((folder / "none").string(), {}, 0, 0.0), 0u);
  fs::remove_all(folder);
}

}  // namespace
}  // namespace rg::coordinator::autoscale
