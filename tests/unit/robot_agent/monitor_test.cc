#include "robot_agent/safety/monitor.h"

#include <gtest/gtest.h>

#include <limits>

namespace rg::robot_agent {
namespace {

constexpr int64_t kTick = 40'000'000;
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

class Monitor : public testing::Test {
 protected:
  Monitor() {
    limits_.lower = {-1, -2};
    limits_.upper = {1, 2};
    limits_.velocity = {1, 3};
    limits_.torque = {10, 5};
    limits_.task.enabled = true;
    for (int i = 0; i < 3; ++i) limits_.task.lower[i] = -0.5, limits_.task.upper[i] = 0.5;
    seen_.has_state = true;
    seen_.state.mode = Mode::kTorque;
    seen_.tip = tip_;
  }

  // One good tick, later than the last by a period.
  Observation& Next() {
    seen_.now_ns += kTick;
    seen_.state.stamp_ns = seen_.now_ns - 10'000'000;
    ++seen_.state.sequence;
    return seen_;
  }
  // The reason after one good tick and one that `spoil` spoils.
  template <class Spoil>
  Trip TripOf(Spoil spoil) {
    SafetyMonitor monitor(limits_, 2);
    EXPECT_EQ(monitor.OnTick(Next()), Action::kCommand);
    Observation bad = Next();
    spoil(bad);
    last_action_ = monitor.OnTick(bad);
    return monitor.trip();
  }

  SafetyLimits limits_;
  Observation seen_;
  double tip_[3] = {0, 0, 0};
  Action last_action_ = Action::kCommand;
};

TEST_F(Monitor, GoodTicksPass) {
  SafetyMonitor monitor(limits_, 2);
  for (int k = 0; k < 100; ++k) EXPECT_EQ(monitor.OnTick(Next()), Action::kCommand);
  EXPECT_EQ(monitor.trip().reason, EndReason::kNone);
}

TEST_F(Monitor, EveryBoxTripsWithJointValueAndLimit) {
  seen_.state.q[1] = -1.99;
  Trip trip = TripOf([](Observation& o) { o.state.q[1] = -2.01; });
  EXPECT_EQ(trip.reason, EndReason::kPositionLimit);
  EXPECT_EQ(trip.joint, 1);
  EXPECT_EQ(trip.value, -2.01);
  EXPECT_EQ(trip.limit, -2.0);
  EXPECT_EQ(last_action_, Action::kZeroAdded);
  EXPECT_EQ(DescribeTrip(trip, {"a", "b"}), "b: position -2.01 outside its limit -2");

  seen_.state.q = {};
  trip = TripOf([](Observation& o) { o.state.v[0] = -1.01; });
  EXPECT_EQ(trip.reason, EndReason::kVelocityLimit);
  EXPECT_EQ(trip.joint, 0);

  double out[3] = {0, 0, 0.51};
  trip = TripOf([&](Observation& o) { o.tip = out; });
  EXPECT_EQ(trip.reason, EndReason::kTaskSpaceLimit);
  EXPECT_EQ(trip.joint, 2);
}

TEST_F(Monitor, NotANumberFromTheRobotTripsAndHoldsAtOnceBecauseGravityIsUnknown) {
  for (auto field : {&RobotState::q, &RobotState::v, &RobotState::effort}) {
    const Trip trip = TripOf([&](Observation& o) { (o.state.*field)[1] = kNan; });
    EXPECT_EQ(trip.reason, EndReason::kRobotNan);
    EXPECT_EQ(trip.joint, 1);
    EXPECT_EQ(last_action_, field == &RobotState::q ? Action::kHold : Action::kZeroAdded);
  }
}

TEST_F(Monitor, NotANumberInTheTaskSpaceTrips) {
  double out[3] = {0, kNan, 0};
  EXPECT_EQ(TripOf([&](Observation& o) { o.tip = out; }).reason, EndReason::kTaskSpaceLimit);
}

TEST_F(Monitor, OldStateIsStaleAndHeld) {
  EXPECT_EQ(TripOf([](Observation& o) { o.now_ns = o.state.stamp_ns + 121'000'000; }).reason,
            EndReason::kStaleState);
  EXPECT_EQ(last_action_, Action::kHold);
}

TEST_F(Monitor, AJumpBeyondWhatVelocityAllowsIsImpossible) {
  // 2 · 1 rad/s · 0.04 s + 0.02 rad = 0.1 rad
  EXPECT_EQ(TripOf([](Observation& o) { o.state.q[0] = 0.099; }).reason, EndReason::kNone);
  const Trip trip = TripOf([](Observation& o) { o.state.q[0] = 0.101; });
  EXPECT_EQ(trip.reason, EndReason::kImpossibleState);
  EXPECT_EQ(last_action_, Action::kHold);
}

TEST_F(Monitor, StampsThatGoBackOrLieAheadAreImpossible) {
  EXPECT_EQ(TripOf([](Observation& o) { o.state.stamp_ns -= kTick + 1; }).reason,
            EndReason::kImpossibleState);
  EXPECT_EQ(TripOf([](Observation& o) { o.state.stamp_ns = o.now_ns + 6'000'000; }).reason,
            EndReason::kImpossibleState);
}

TEST_F(Monitor, LostDriverModeLostOperatorRecorderAndTimeUpTrip) {
  EXPECT_EQ(TripOf([](Observation& o) { o.connected = false; }).reason, EndReason::kDriverLost);
  EXPECT_EQ(last_action_, Action::kHold);
  EXPECT_EQ(TripOf([](Observation& o) { o.state.mode = Mode::kPosition; }).reason, EndReason::kModeLost);
  EXPECT_EQ(last_action_, Action::kHold);
  EXPECT_EQ(TripOf([](Observation& o) { o.operator_stop = true; }).reason, EndReason::kOperatorStop);
  EXPECT_EQ(last_action_, Action::kZeroAdded);
  EXPECT_EQ(TripOf([](Observation& o) { o.recorder_ok = false; }).reason, EndReason::kRecorderFailed);
  EXPECT_EQ(TripOf([](Observation& o) { o.time_up = true; }).reason, EndReason::kCompleted);
}

TEST_F(Monitor, AnUnsafeStateAtTheLastTickIsNotCompleted) {
  EXPECT_EQ(TripOf([](Observation& o) { o.time_up = true, o.state.q[0] = 0.05, o.state.v[0] = 7; }).reason,
            EndReason::kVelocityLimit);
}

TEST_F(Monitor, MissedDeadlinesInARowTripSingleOnesDoNot) {
  SafetyMonitor patient(limits_, 2);
  for (int k = 0; k < 100; ++k) {
    Next().missed = k % 10 == 0 ? 1 : 0;
    EXPECT_EQ(patient.OnTick(seen_), Action::kCommand) << k;
  }
  SafetyMonitor monitor(limits_, 2);
  Next().missed = 1;
  for (int k = 0; k < 3; ++k) EXPECT_EQ(monitor.OnTick(Next()), Action::kCommand);
  monitor.OnTick(Next());
  EXPECT_EQ(monitor.trip().reason, EndReason::kMissedDeadlines);
}

TEST_F(Monitor, AThirdOfAllDeadlinesMissedTripsAfterASecond) {
  SafetyMonitor monitor(limits_, 2);
  int k = 0;
  while (monitor.trip().reason == EndReason::kNone && k < 100) {
    Next().missed = k++ % 3 == 0 ? 1 : 0;
    monitor.OnTick(seen_);
  }
  EXPECT_EQ(monitor.trip().reason, EndReason::kMissedDeadlines);
  EXPECT_GE(k, 25);
  EXPECT_LE(k, 27);
}

TEST_F(Monitor, StopIsZeroTorqueForItsTimeThenHoldForGood) {
  SafetyMonitor monitor(limits_, 2);
  monitor.OnTick(Next());
  Next().operator_stop = true;
  EXPECT_EQ(monitor.OnTick(seen_), Action::kZeroAdded);
  seen_.operator_stop = false;
  EXPECT_EQ(monitor.OnTick(Next()), Action::kZeroAdded);
  EXPECT_EQ(monitor.OnTick(Next()), Action::kZeroAdded);
  EXPECT_EQ(monitor.OnTick(Next()), Action::kHold);  // 0.12 s after the trip
  EXPECT_EQ(monitor.OnTick(Next()), Action::kHold);
  EXPECT_EQ(monitor.trip().reason, EndReason::kOperatorStop);
}

TEST_F(Monitor, StateLostWhileStoppingHoldsAtOnceAndKeepsTheFirstReason) {
  SafetyMonitor monitor(limits_, 2);
  monitor.OnTick(Next());
  Next().operator_stop = true;
  EXPECT_EQ(monitor.OnTick(seen_), Action::kZeroAdded);
  Next().connected = false;
  EXPECT_EQ(monitor.OnTick(seen_), Action::kHold);
  EXPECT_EQ(monitor.trip().reason, EndReason::kOperatorStop);
}

TEST_F(Monitor, CommandsAreLimitedCountedAndFarBeyondTheLimitTrip) {
  SafetyMonitor monitor(limits_, 2);
  monitor.OnTick(Next());
  double tau[2] = {12, -4};
  EXPECT_EQ(monitor.LimitCommand(tau, seen_.now_ns), Action::kCommand);
  EXPECT_EQ(tau[0], 10);
  EXPECT_EQ(tau[1], -4);
  EXPECT_EQ(monitor.saturated_samples(), 1u);
  double wild[2] = {0, -15.1};
  EXPECT_EQ(monitor.LimitCommand(wild, seen_.now_ns), Action::kZeroAdded);
  EXPECT_EQ(monitor.trip().reason, EndReason::kTorqueLimit);
  EXPECT_EQ(monitor.trip().joint, 1);
}

TEST_F(Monitor, NotANumberFromTheControllerTrips) {
  SafetyMonitor monitor(limits_, 2);
  monitor.OnTick(Next());
  double tau[2] = {0, std::numeric_limits<double>::infinity()};
  EXPECT_EQ(monitor.LimitCommand(tau, seen_.now_ns), Action::kZeroAdded);
  EXPECT_EQ(monitor.trip().reason, EndReason::kControllerNan);
  EXPECT_EQ(monitor.OnTick(Next()), Action::kZeroAdded);
}

TEST(EndReasons, NamesAreReadBack) {
  for (int r = 0; r <= static_cast<int>(EndReason::kNotStarted); ++r)
    EXPECT_EQ(EndReasonFromName(EndReasonName(static_cast<EndReason>(r))), static_cast<EndReason>(r));
}

}  // namespace
}  // namespace rg::robot_agent
