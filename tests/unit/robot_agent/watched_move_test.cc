#include "robot_agent/safety/watched_move.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "tests/unit/robot_agent/fake_driver.h"

namespace rg::robot_agent {
namespace {

using testing::HasSubstr;

class WatchedMoves : public testing::Test {
 protected:
  WatchedMoves() {
    limits_.lower = {-1, -1};
    limits_.upper = {1, 1};
    limits_.velocity = {1, 1};
    limits_.torque = {10, 10};
    limits_.torque_rate = {1000, 1000};
    options_.timeout_s = 10;
  }
  // Joint a goes to 0.5 at 0.5 rad/s; `stop_at`: where it stays.
  void Ramp(double stop_at) {
    driver_.script = [stop_at](FakeDriver& d) {
      if (d.moves == 0 || d.holds > 0) return;
      d.state.q[0] = std::min(stop_at, d.state.q[0] + 0.5 * 0.02);
      d.state.moving = d.state.q[0] < std::min(stop_at, 0.5);
    };
  }
  MoveOutcome Go() {
    const double pose[2] = {0.5, 0};
    return MoveUnderWatch(driver_, arm_, limits_, pose, options_, stop_);
  }

  FakeDriver driver_;
  FakeArm arm_;
  SafetyLimits limits_;
  MoveOptions options_;
  CancelToken stop_;
};

TEST_F(WatchedMoves, ArrivesSettlesAndLeavesTheArmAlone) {
  Ramp(0.5);
  const MoveOutcome moved = Go();
  EXPECT_TRUE(moved.status.ok()) << moved.status.ToString();
  EXPECT_EQ(driver_.holds, 0);
  EXPECT_NEAR(driver_.state.q[0], 0.5, 0.05);
}

TEST_F(WatchedMoves, NothingIsStartedFromAStateThatIsNotAllowed) {
  driver_.state.q[1] = std::nan("");
  EXPECT_EQ(Go().status.code(), StatusCode::kFailedPrecondition);
  EXPECT_EQ(driver_.moves, 0);
}

TEST_F(WatchedMoves, AnArmThatStopsShortIsNotWaitedForUntilTheTimeOut) {
  Ramp(0.3);
  const MoveOutcome moved = Go();
  EXPECT_THAT(moved.status.message(), HasSubstr("stopped by itself"));
  EXPECT_TRUE(moved.stop.confirmed) << moved.stop.why;
  EXPECT_GE(driver_.holds, 1);
}

// As a preparation that fails beside the start pose.
TEST_F(WatchedMoves, AWayThatTheDriverGaveUpIsNoArrivalThoughItEndsAtThePose) {
  Ramp(0.5);
  driver_.move_end = FailedPreconditionError("joint b is deaf");
  const MoveOutcome moved = Go();
  EXPECT_EQ(moved.status.code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(moved.status.message(), HasSubstr("joint b is deaf"));
}

TEST_F(WatchedMoves, OneThatIsTooSlowIsStoppedAtTheTimeOut) {
  options_.timeout_s = 0.4;
  Ramp(0.5);
  const MoveOutcome moved = Go();
  EXPECT_EQ(moved.status.code(), StatusCode::kDeadlineExceeded);
  EXPECT_TRUE(moved.stop.confirmed) << moved.stop.why;
}

TEST_F(WatchedMoves, TooFastStopsIt) {
  limits_.velocity = {0.4, 1};
  Ramp(0.5);
  const MoveOutcome moved = Go();
  EXPECT_EQ(moved.trip.reason, EndReason::kVelocityLimit);
  EXPECT_LT(driver_.state.q[0], 0.1);
  EXPECT_GE(driver_.holds, 1);
}

TEST_F(WatchedMoves, ADriverThatCannotMoveUnderWatchDoesNotMove) {
  class OldDriver final : public Driver {
   public:
    explicit OldDriver(FakeDriver& arm) : arm_(arm) {}
    Status Connect(double t) override { return arm_.Connect(t); }
    const DriverInfo& info() const override { return arm_.info(); }
    DriverHealth health() const override { return arm_.health(); }
    int64_t NowNanos() const override { return arm_.NowNanos(); }
    Status SleepUntil(int64_t t) override { return arm_.SleepUntil(t); }
    Status ReadState(RobotState* state) override { return arm_.ReadState(state); }
    Status EnterTorqueMode(const double* tau) override { return arm_.EnterTorqueMode(tau); }
    Status SendTorque(const double* tau) override { return arm_.SendTorque(tau); }
    Status Hold() override { return arm_.Hold(); }
    FakeDriver& arm_;
  } old(driver_);
  const double pose[2] = {0.5, 0};
  const MoveOutcome moved = MoveUnderWatch(old, arm_, limits_, pose, options_, stop_);
  EXPECT_THAT(moved.status.message(), HasSubstr("cannot move to a pose while it is watched"));
}

}  // namespace
}  // namespace rg::robot_agent
