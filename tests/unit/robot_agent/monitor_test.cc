#include "robot_agent/safety/monitor.h"

#include <gtest/gtest.h>

#include <limits>
#include <utility>

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
    limits_.torque_rate = {1000, 1000};
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
  trip = TripOf([](Observation& o) { o.state.q[0] = -1.01 * 0.04; });
  EXPECT_EQ(trip.reason, EndReason::kVelocityLimit);
  EXPECT_EQ(trip.joint, 0);
  EXPECT_NEAR(trip.value, -1.01, 1e-9);

  double out[3] = {0, 0, 0.51};
  trip = TripOf([&](Observation& o) { o.tip = out; });
  EXPECT_EQ(trip.reason, EndReason::kTaskSpaceLimit);
  EXPECT_EQ(trip.joint, 2);
  for (int axis = 0; axis < 3; ++axis) {
    double below[3] = {0, 0, 0};
    below[axis] = limits_.task.lower[axis] - 0.01;
    trip = TripOf([&](Observation& o) { o.tip = below; });
    EXPECT_EQ(trip.reason, EndReason::kTaskSpaceLimit);
    EXPECT_EQ(trip.joint, axis);
    EXPECT_EQ(trip.limit, limits_.task.lower[axis]);
  }
}

TEST_F(Monitor, PartsThatOverlapTripAndWhereTheyAreIsNotANumberToo) {
  EXPECT_EQ(TripOf([](Observation& o) { o.clearance = 0.001; }).reason, EndReason::kNone);
  const Trip trip = TripOf([](Observation& o) { o.clearance = -0.01, o.nearest_pair = 1; });
  EXPECT_EQ(trip.reason, EndReason::kSelfCollision);
  EXPECT_EQ(DescribeTrip(trip, {}),
            "parts of the arm that have to stay apart (pair 2) are -0.01 m apart, limit 0 m");
  EXPECT_EQ(TripOf([](Observation& o) { o.clearance = kNan; }).reason, EndReason::kSelfCollision);
  seen_.state.mode = Mode::kPosition;
  seen_.clearance = -0.05;  // it stands there already: it may come out, not go in
  SafetyMonitor monitor(limits_, 2);
  EXPECT_EQ(monitor.OnMove(Next(), true), Action::kCommand);
  seen_.clearance = -0.04;
  EXPECT_EQ(monitor.OnMove(Next(), true), Action::kCommand);
  seen_.clearance = -0.08;
  EXPECT_EQ(monitor.OnMove(Next(), true), Action::kHold);
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
  EXPECT_EQ(TripOf([](Observation& o) { o.state.q[0] = 0.099; }).reason, EndReason::kVelocityLimit);
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
  EXPECT_EQ(TripOf([](Observation& o) { o.time_up = true, o.state.q[0] = 0.09; }).reason,
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
  EXPECT_EQ(monitor.LimitCommand(tau, nullptr, seen_.now_ns), Action::kCommand);
  EXPECT_EQ(tau[0], 10);
  EXPECT_EQ(tau[1], -4);
  EXPECT_EQ(monitor.saturated_samples(), 1u);
  double wild[2] = {0, -15.1};
  EXPECT_EQ(monitor.LimitCommand(wild, nullptr, seen_.now_ns), Action::kZeroAdded);
  EXPECT_EQ(monitor.trip().reason, EndReason::kTorqueLimit);
  EXPECT_EQ(monitor.trip().joint, 1);
}

TEST_F(Monitor, ATorqueIsBuiltUpAtItsRateAndLetGoAtOnce) {
  limits_.torque_rate = {25, 25};  // 1 N·m per tick
  SafetyMonitor monitor(limits_, 2, 0.04);
  const double gravity[2] = {2, -1};
  double tau[2] = {2, -1};
  const auto after = [&](double a, double b) {
    monitor.OnTick(Next());
    tau[0] = a, tau[1] = b;
    monitor.LimitCommand(tau, gravity, seen_.now_ns);
    return std::pair(tau[0], tau[1]);
  };
  EXPECT_EQ(after(2, -1), std::pair(2.0, -1.0));
  EXPECT_EQ(after(9, -5), std::pair(3.0, -2.0));
  EXPECT_EQ(after(9, -5), std::pair(4.0, -3.0));
  EXPECT_EQ(after(2, -1), std::pair(2.0, -1.0)) << "zero added torque is not held up";
  EXPECT_EQ(after(4, -1), std::pair(3.0, -1.0));
  EXPECT_EQ(after(-9, -1), std::pair(2.0, -1.0)) << "through gravity it is a torque the other way";
}

TEST_F(Monitor, NotANumberFromTheControllerTrips) {
  SafetyMonitor monitor(limits_, 2);
  monitor.OnTick(Next());
  double tau[2] = {0, std::numeric_limits<double>::infinity()};
  EXPECT_EQ(monitor.LimitCommand(tau, nullptr, seen_.now_ns), Action::kZeroAdded);
  EXPECT_EQ(monitor.trip().reason, EndReason::kControllerNan);
  EXPECT_EQ(monitor.OnTick(Next()), Action::kZeroAdded);
}

TEST_F(Monitor, AMoveIsJudgedLikeARolloutAndEndsInPositionMode) {
  seen_.state.mode = Mode::kPosition;
  const auto trip_of = [&](auto spoil) {
    SafetyMonitor monitor(limits_, 2);
    EXPECT_EQ(monitor.OnMove(Next(), true), Action::kCommand);
    Observation bad = Next();
    spoil(bad);
    EXPECT_EQ(monitor.OnMove(bad, true), Action::kHold);
    EXPECT_EQ(monitor.OnMove(Next(), true), Action::kHold) << "a trip is never undone";
    return monitor.trip().reason;
  };
  EXPECT_EQ(trip_of([](Observation& o) { o.state.q[0] = 0.05; }), EndReason::kVelocityLimit);
  EXPECT_EQ(trip_of([](Observation& o) { o.state.q[0] = 0.5; }), EndReason::kImpossibleState);
  EXPECT_EQ(trip_of([](Observation& o) { o.operator_stop = true; }), EndReason::kOperatorStop);
  EXPECT_EQ(trip_of([](Observation& o) { o.connected = false; }), EndReason::kDriverLost);
  EXPECT_EQ(trip_of([](Observation& o) { o.state.mode = Mode::kTorque; }), EndReason::kModeLost);
  EXPECT_EQ(trip_of([](Observation& o) { o.state.q[1] = kNan; }), EndReason::kRobotNan);
  EXPECT_EQ(trip_of([](Observation& o) { o.now_ns = o.state.stamp_ns + 481'000'000; }),
            EndReason::kStaleState);
  static double out[3] = {0, 0, 0.51};
  EXPECT_EQ(trip_of([&](Observation& o) { o.tip = out; }), EndReason::kTaskSpaceLimit);
  seen_.state.q[1] = 1.99;
  EXPECT_EQ(trip_of([](Observation& o) { o.state.q[1] = 2.01; }), EndReason::kPositionLimit);
}

TEST_F(Monitor, AMoveMayPrepareTheArmWithTestTorques) {
  seen_.state.mode = Mode::kPosition;
  SafetyMonitor monitor(limits_, 2);
  EXPECT_EQ(monitor.OnMove(Next(), true), Action::kCommand);
  seen_.state.mode = Mode::kTorque;
  seen_.state.moving = true;
  EXPECT_EQ(monitor.OnMove(Next(), true), Action::kCommand);
  seen_.state.q[0] = 0.05;  // 1.25 rad/s, limit 1
  EXPECT_EQ(monitor.OnMove(Next(), true), Action::kHold);
  EXPECT_EQ(monitor.trip().reason, EndReason::kVelocityLimit);
  SafetyMonitor running(limits_, 2);
  seen_.state.mode = Mode::kPosition;
  EXPECT_NE(running.OnTick(Next()), Action::kCommand) << "a rollout is in torque mode, moving or not";
}

TEST_F(Monitor, AMoveMayComeBackIntoTheBoxButGoNoFurtherOut) {
  seen_.state.mode = Mode::kPosition;
  seen_.state.q[1] = 2.3;
  SafetyMonitor inwards(limits_, 2);
  for (int k = 0; k < 20; ++k, seen_.state.q[1] -= 0.03)
    EXPECT_EQ(inwards.OnMove(Next(), true), Action::kCommand) << k;
  seen_.state.q[1] = 2.3;
  SafetyMonitor outwards(limits_, 2);
  EXPECT_EQ(outwards.OnMove(Next(), true), Action::kCommand);
  seen_.state.q[1] = 2.33;
  EXPECT_EQ(outwards.OnMove(Next(), true), Action::kHold);
  EXPECT_EQ(outwards.trip().reason, EndReason::kPositionLimit);
}

TEST_F(Monitor, AMoveThatNeverBeginsIsAFrozenState) {
  seen_.state.mode = Mode::kPosition;
  SafetyMonitor monitor(limits_, 2);
  int k = 0;
  while (monitor.OnMove(Next(), true) == Action::kCommand && k < 100) ++k;
  EXPECT_EQ(monitor.trip().reason, EndReason::kFrozenState);
  EXPECT_NEAR(0.04 * k, limits_.freeze_start_s, 0.08);
  SafetyMonitor settling(limits_, 2);
  for (k = 0; k < 100; ++k)
    EXPECT_EQ(settling.OnMove(Next(), false), Action::kCommand) << "at rest is no fault";
}

TEST_F(Monitor, APushThatMovesNothingAtAllIsAFrozenStateASmallOneIsNot) {
  const double gravity[2] = {0, 0};
  for (const double share : {0.4, 0.6}) {
    SafetyMonitor monitor(limits_, 2);
    int k = 0;
    while (k < 100 && monitor.OnTick(Next()) == Action::kCommand) {
      double tau[2] = {share * limits_.torque[0], 0};
      monitor.LimitCommand(tau, gravity, seen_.now_ns);
      ++k;
    }
    EXPECT_EQ(monitor.trip().reason, share > 0.5 ? EndReason::kFrozenState : EndReason::kNone);
    if (share > 0.5) {
      EXPECT_NEAR(0.04 * k, limits_.freeze_start_s, 0.08);
    }
  }
}

TEST_F(Monitor, TheFirstTorqueIsRefusedNotLimited) {
  seen_.state.mode = Mode::kPosition;
  const double good[2] = {9.9, -4.9}, large[2] = {0, 5.1}, nan[2] = {kNan, 0};
  SafetyMonitor monitor(limits_, 2);
  EXPECT_EQ(monitor.CheckFirst(Next(), good), Action::kCommand);
  SafetyMonitor strict(limits_, 2);
  EXPECT_EQ(strict.CheckFirst(Next(), large), Action::kHold);
  EXPECT_EQ(strict.trip().reason, EndReason::kTorqueLimit);
  EXPECT_EQ(strict.trip().joint, 1);
  SafetyMonitor wary(limits_, 2);
  EXPECT_EQ(wary.CheckFirst(Next(), nan), Action::kHold);
  seen_.state.mode = Mode::kTorque;
  SafetyMonitor puzzled(limits_, 2);
  EXPECT_EQ(puzzled.CheckFirst(Next(), good), Action::kHold) << "torque mode already";
}

TEST(EndReasons, NamesAreReadBack) {
  for (int r = 0; r <= static_cast<int>(EndReason::kSelfCollision); ++r)
    EXPECT_EQ(EndReasonFromName(EndReasonName(static_cast<EndReason>(r))), static_cast<EndReason>(r));
}

}  // namespace
}  // namespace rg::robot_agent
