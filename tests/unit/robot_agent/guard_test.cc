#include "robot_agent/guard/guard.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <thread>

#include "common/base/ids.h"
#include "robot_agent/control_loop.h"
#include "robot_agent/drivers/robot_protocol.h"
#include "robot_agent/guard/guard_driver.h"
#include "robot_agent/safety/latch.h"
#include "tests/unit/robot_agent/fake_driver.h"

namespace rg::robot_agent {
namespace {

using testing::HasSubstr;

// A guard in a thread, before a fake arm. End() closes the agent's side and waits for the guard.
class GuardedArm : public testing::Test {
 protected:
  GuardedArm() : folder_((std::filesystem::temp_directory_path() / ("rg-guard-" + RandomHex(6))).string()) {
    std::filesystem::create_directories(folder_);
    options_.latch_folder = folder_;
  }
  ~GuardedArm() override {
    End();
    std::filesystem::remove_all(folder_);
  }
  GuardDriver& Start(bool lock_step = true) {
    arm_.info_.lock_step = lock_step;
    auto pair = PacketSocket::Pair().value();
    agent_ = std::make_unique<GuardDriver>(std::move(pair.first), 0.04);
    guards_end_ = std::move(pair.second);
    guard_ = std::make_unique<Guard>(arm_, model_, limits_, guards_end_, options_);
    thread_ = std::thread([this] { guard_->Run(); });
    EXPECT_TRUE(agent_->Connect(1).ok());
    return *agent_;
  }
  void End() {
    agent_.reset();
    if (thread_.joinable()) thread_.join();
    guards_end_.Close();
  }
  void EnterAndSend(int commands) {
    const double first[2] = {1, 2}, tau[2] = {3, -4};
    ASSERT_TRUE(agent_->EnterTorqueMode(first).ok());
    for (int k = 0; k < commands; ++k) {
      ASSERT_TRUE(agent_->SleepUntil(agent_->NowNanos() + 40'000'000).ok());
      ASSERT_TRUE(agent_->SendTorque(tau).ok());
    }
  }

  std::string folder_;
  FakeDriver arm_;
  FakeArm model_;
  SafetyLimits limits_ = FakeLimits();
  GuardOptions options_;
  PacketSocket guards_end_;
  std::unique_ptr<GuardDriver> agent_;
  std::unique_ptr<Guard> guard_;
  std::thread thread_;
};

TEST_F(GuardedArm, AWholeRolloutIsTheSameAsWithoutIt) {
  std::vector<std::array<double, 2>> sent[2];
  for (int k = 0; k < 2; ++k) {
    arm_ = FakeDriver();
    Driver& driver = k == 0 ? static_cast<Driver&>(arm_) : Start();
    const std::string path = folder_ + "/" + std::to_string(k) + ".rec";
    auto recorder = Recorder::Start(path, "{}", 2, {}).value();
    FunctionController controller([](double t, const double*, const double*, double* tau) {
      tau[0] = 3 + t;
      tau[1] = -4;
    });
    ControlLoopOptions options;
    options.duration_s = 1.0;
    CancelToken stop;
    const auto result =
        RunControlLoop(driver, controller, model_, limits_, options, *recorder, stop, RealClock());
    EXPECT_EQ(result.trip.reason, EndReason::kCompleted);
    EXPECT_TRUE(result.stop.confirmed);
    End();
    sent[k].assign(arm_.sent.begin(), arm_.sent.begin() + static_cast<long>(arm_.sent_count));
  }
  EXPECT_EQ(sent[0], sent[1]);
  EXPECT_GT(sent[1].size(), 20u);
}

// An arm that proves torque mode takes seconds, and moves meanwhile.
TEST_F(GuardedArm, AStopIsHeardWhileTorqueModeIsEntered) {
  GuardDriver& agent = Start();
  arm_.slow_entry = true;
  CancelToken stop;
  agent.HeedStop(&stop);
  std::thread person([&stop] {
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
    stop.Cancel();
  });
  const double first[2] = {1, 2};
  const Status entered = agent.EnterTorqueMode(first);
  person.join();
  EXPECT_EQ(entered.code(), StatusCode::kCancelled) << entered.ToString();
  EXPECT_EQ(agent.SleepUntil(agent.NowNanos()).code(), StatusCode::kOk) << "it answers as before";
  End();
  EXPECT_TRUE(guard_->last_stop().confirmed) << guard_->last_stop().why;
  EXPECT_GE(arm_.holds, 1);
}

TEST_F(GuardedArm, StatesAreJudgedWhileTorqueModeIsEntered) {
  GuardDriver& agent = Start();
  arm_.slow_entry = true;
  arm_.script = [](FakeDriver& d) {
    if (d.holds > 0) return;
    d.now_ += 40'000'000, d.state.stamp_ns += 40'000'000, ++d.state.sequence;
    d.state.q[0] += 0.04;  // 1 rad/s; its box ends at 1
  };
  const double first[2] = {1, 2};
  const Status entered = agent.EnterTorqueMode(first);
  EXPECT_EQ(entered.code(), StatusCode::kAborted) << entered.ToString();
  EXPECT_EQ(agent.trip().reason, EndReason::kPositionLimit);
  End();
  EXPECT_LT(arm_.state.q[0], 1.09);
  EXPECT_TRUE(guard_->last_stop().confirmed) << guard_->last_stop().why;
}

TEST_F(GuardedArm, AnAgentThatIsGoneWhileTorqueModeIsEnteredEndsItAndLeavesNoLatch) {
  arm_.slow_entry = true;
  ASSERT_TRUE(Latch(folder_).BeginMotion("r", "now").ok());
  auto pair = PacketSocket::Pair().value();
  Guard guard(arm_, model_, limits_, pair.second, options_);
  std::thread serving([&guard] { guard.Run(); });
  GuardMessage request, reply;
  request.request = GuardRequest::kConnect;
  ASSERT_TRUE(pair.first.Send(&request, sizeof request).ok());
  std::string text(kMaxInfoText, '\0');
  ASSERT_EQ(pair.first.Receive(&reply, sizeof reply, 20.0).code, StatusCode::kOk);
  ASSERT_EQ(pair.first.Receive(text.data(), text.size(), 20.0).code, StatusCode::kOk);
  request.request = GuardRequest::kEnter;
  request.number = 0.04;
  request.values = {1, 2};
  ASSERT_TRUE(pair.first.Send(&request, sizeof request).ok());
  std::this_thread::sleep_for(std::chrono::milliseconds(50));
  pair.first.Close();
  serving.join();
  EXPECT_TRUE(guard.last_stop().confirmed) << guard.last_stop().why;
  EXPECT_GE(arm_.holds, 1);
  EXPECT_EQ(arm_.state.mode, Mode::kPosition);
  EXPECT_FALSE(Latch(folder_).Read().has_value()) << "it was seen at rest";
}

// What the guard stopped, and the agent has judged: its latch stays.
TEST_F(GuardedArm, ALatchThatTheAgentHasSetStays) {
  GuardDriver& agent = Start(false);
  ASSERT_TRUE(Latch(folder_).BeginMotion("r", "now").ok());
  EnterAndSend(2);
  RobotState state;
  for (int i = 0; i < 1000 && agent.trip().reason == EndReason::kNone; ++i) {
    usleep(10'000);
    ASSERT_TRUE(agent.ReadState(&state).ok());
  }
  ASSERT_EQ(agent.trip().reason, EndReason::kControllerHung);
  ASSERT_TRUE(Latch(folder_).Set("r", "not seen at rest", "now").ok());
  End();
  ASSERT_TRUE(Latch(folder_).Read().has_value());
  EXPECT_TRUE(Latch(folder_).Read()->latched);
}

// A topic, say. Under torque and on the way to a pose.
TEST_F(GuardedArm, AStopByTheDriversOwnMeansIsAStop) {
  GuardDriver& agent = Start();
  EnterAndSend(3);
  arm_.stop_wanted = true;
  const double tau[2] = {3, -4};
  ASSERT_TRUE(agent.SleepUntil(agent.NowNanos() + 40'000'000).ok());
  EXPECT_EQ(agent.SendTorque(tau).code(), StatusCode::kAborted);
  EXPECT_EQ(agent.trip().reason, EndReason::kOperatorStop);
  EXPECT_EQ(agent.EnterTorqueMode(tau).code(), StatusCode::kAborted);
  const double pose[2] = {0.5, 0};
  EXPECT_EQ(agent.StartMove(pose).code(), StatusCode::kAborted);
  EXPECT_EQ(arm_.moves, 0);
  arm_.stop_wanted = false;
  ASSERT_TRUE(agent.StartMove(pose).ok());
  arm_.stop_wanted = true;
  RobotState state;
  (void)agent.ReadState(&state).ok();
  EXPECT_EQ(agent.MoveEnd().code(), StatusCode::kAborted);
  End();
  EXPECT_TRUE(guard_->last_stop().confirmed) << guard_->last_stop().why;
}

TEST_F(GuardedArm, AFirstTorqueBeyondItsLimitsDoesNotReachTheArm) {
  GuardDriver& agent = Start();
  const double wild[2] = {11, 0};
  const Status refused = agent.EnterTorqueMode(wild);
  EXPECT_EQ(refused.code(), StatusCode::kAborted);
  EXPECT_THAT(refused.message(), HasSubstr("torque_limit"));
  End();
  EXPECT_TRUE(arm_.entered.empty());
  EXPECT_GE(arm_.holds, 1);
}

TEST_F(GuardedArm, WhatTheAgentMustNotSendDoesNotReachTheArm) {
  for (const double bad : {std::nan(""), 31.0}) {
    arm_ = FakeDriver();
    GuardDriver& agent = Start();
    EnterAndSend(3);
    const double tau[2] = {0, bad};
    ASSERT_TRUE(agent.SleepUntil(agent.NowNanos() + 40'000'000).ok());
    EXPECT_EQ(agent.SendTorque(tau).code(), StatusCode::kAborted);
    const double good[2] = {0, 0};
    EXPECT_EQ(agent.SendTorque(good).code(), StatusCode::kAborted) << "a stop is never undone";
    EXPECT_EQ(agent.trip().reason, std::isnan(bad) ? EndReason::kControllerNan : EndReason::kTorqueLimit);
    End();
    for (size_t k = 0; k < arm_.sent_count; ++k) EXPECT_LE(std::abs(arm_.sent[k][1]), 10.0);
    EXPECT_EQ(arm_.sent[3], (std::array<double, 2>{1, 2})) << "zero added torque first";
    EXPECT_GE(arm_.holds, 1);
    EXPECT_TRUE(guard_->last_stop().confirmed);
  }
}

TEST_F(GuardedArm, AStateOutsideItsBoxStopsTheArmAtTheNextCommand) {
  GuardDriver& agent = Start();
  EnterAndSend(2);
  arm_.script = [](FakeDriver& d) {
    if (d.tick == 3) d.state.q[0] = 0.07;  // 1.75 rad/s
    if (d.tick >= 4) d.state.q[0] = 0.17;  // 2.5 rad/s
  };
  const double tau[2] = {0, 0};
  Status sent;
  for (int k = 0; k < 4 && sent.ok(); ++k) {
    ASSERT_TRUE(agent.SleepUntil(agent.NowNanos() + 40'000'000).ok());
    sent = agent.SendTorque(tau);
  }
  EXPECT_THAT(sent.message(), HasSubstr("velocity_limit"));
}

TEST_F(GuardedArm, AControllerThatHangsStopsTheArm) {
  Start(false);
  options_ = {};
  EnterAndSend(2);
  while (!guards_end_.open()) usleep(1000);
  usleep(400'000);  // the controller thinks, for ten periods
  RobotState state;
  ASSERT_TRUE(agent_->ReadState(&state).ok());
  EXPECT_EQ(agent_->trip().reason, EndReason::kControllerHung);
  EXPECT_LT(agent_->trip().limit, 0.08);
  EXPECT_GE(agent_->trip().value, agent_->trip().limit);
  EXPECT_EQ(state.mode, Mode::kPosition);
  const double tau[2] = {0, 0};
  EXPECT_EQ(agent_->SendTorque(tau).code(), StatusCode::kAborted) << "it wakes up too late";
  std::printf("stopped after %.1f ms, two periods are 80 ms\n", 1e3 * agent_->trip().value);
}

TEST_F(GuardedArm, AnAgentThatIsGoneLeavesAnArmAtRestAndNoLatch) {
  Start();
  ASSERT_TRUE(Latch(folder_).BeginMotion("r", "now").ok());
  EnterAndSend(3);
  End();
  EXPECT_GE(arm_.holds, 1);
  EXPECT_EQ(arm_.state.mode, Mode::kPosition);
  EXPECT_TRUE(guard_->last_stop().confirmed);
  EXPECT_FALSE(Latch(folder_).Read().has_value());
}

TEST_F(GuardedArm, AnAgentThatIsGoneAndAnArmThatCreepsOnAreLatched) {
  Start();
  ASSERT_TRUE(Latch(folder_).BeginMotion("r", "now").ok());
  EnterAndSend(3);
  arm_.script = [](FakeDriver& d) { d.state.q[0] += 0.05 * 0.02; };
  End();
  EXPECT_FALSE(guard_->last_stop().confirmed);
  ASSERT_TRUE(Latch(folder_).Read().has_value());
  EXPECT_TRUE(Latch(folder_).Read()->latched);
  EXPECT_EQ(Latch(folder_).Read()->rollout, "r");
}

TEST_F(GuardedArm, APoseOutsideItsBoxesIsNotMovedTo) {
  GuardDriver& agent = Start();
  const double outside[2] = {0, 1.5}, inside[2] = {0, 0.5};
  EXPECT_EQ(agent.StartMove(outside).code(), StatusCode::kInvalid);
  EXPECT_TRUE(agent.StartMove(inside).ok());
  End();
  EXPECT_EQ(arm_.moves, 1);
}

TEST_F(GuardedArm, ACommandTwiceOrTooLateIsNotSent) {
  auto pair = PacketSocket::Pair().value();  // spoken to by hand
  Guard guard(arm_, model_, limits_, pair.second, options_);
  std::thread thread([&] { guard.Run(); });
  GuardMessage message, reply;
  const auto ask = [&](GuardRequest request) {
    message.request = request;
    EXPECT_TRUE(pair.first.Send(&message, sizeof message).ok());
    EXPECT_EQ(pair.first.Receive(&reply, sizeof reply, 5).code, StatusCode::kOk);
    return reply.code;
  };
  message.number = 1.0;
  EXPECT_EQ(ask(GuardRequest::kConnect), StatusCode::kOk);
  std::string info(4096, ' ');
  EXPECT_EQ(pair.first.Receive(info.data(), info.size(), 5).code, StatusCode::kOk);
  message.number = 0.04;
  message.values = {1, 2};
  EXPECT_EQ(ask(GuardRequest::kEnter), StatusCode::kOk);
  message.sequence = 7;
  message.deadline_ns = arm_.now_ + 1'000'000;
  EXPECT_EQ(ask(GuardRequest::kTorque), StatusCode::kOk);
  EXPECT_EQ(ask(GuardRequest::kTorque), StatusCode::kInvalid) << "twice";
  message.sequence = 8;
  message.deadline_ns = arm_.now_ - 1;
  EXPECT_EQ(ask(GuardRequest::kTorque), StatusCode::kDeadlineExceeded);
  EXPECT_EQ(arm_.sent_count, 1u);
  pair.first.Close();
  thread.join();
}

}  // namespace
}  // namespace rg::robot_agent
