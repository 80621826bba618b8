#include "robot_agent/control_loop.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <limits>

#include "common/base/ids.h"
#include "tests/unit/robot_agent/allocation_counter.h"
#include "tests/unit/robot_agent/fake_driver.h"

namespace rg::robot_agent {
namespace {

struct Outcome {
  ControlLoopResult result;
  RawRecording recording;
  long allocations = 0;
};

class ControlLoop : public testing::Test {
 protected:
  Outcome Run(double duration_s, FunctionController::Function function) {
    const auto folder = std::filesystem::temp_directory_path() / ("rg-loop-" + RandomHex(6));
    const std::string path = (folder / "x.rec").string();
    auto recorder = Recorder::Start(path, "{}", 2, {.poll_s = 0.002}).value();
    FunctionController controller(std::move(function));
    ControlLoopOptions options = options_;
    options.duration_s = duration_s;
    Outcome outcome;
    const long before = AllocationsOfThisThread();
    outcome.result =
        RunControlLoop(driver_, controller, arm_, limits_, options, *recorder, stop_, RealClock());
    outcome.allocations = AllocationsOfThisThread() - before;
    EXPECT_TRUE(recorder->Finish("{}").ok());
    outcome.recording = ReadRawRecording(path).value();
    std::filesystem::remove_all(folder);
    return outcome;
  }

  static void Constant(double, const double*, const double*, double* tau) { tau[0] = 3, tau[1] = -4; }

  FakeDriver driver_;
  FakeArm arm_;
  SafetyLimits limits_ = FakeLimits();
  ControlLoopOptions options_;
  CancelToken stop_;
};

TEST_F(ControlLoop, RunsTheGivenTimeAtTheGivenRateThenCarriesGravityThenHolds) {
  const Outcome outcome = Run(2.0, Constant);
  EXPECT_EQ(outcome.result.trip.reason, EndReason::kCompleted);
  EXPECT_EQ(outcome.result.commands, 50u);
  EXPECT_NEAR(outcome.result.duration_s, 2.0, 1e-9);
  EXPECT_EQ(driver_.holds, 1);
  EXPECT_EQ(driver_.sent[49], (std::array<double, 2>{3, -4}));
  EXPECT_EQ(driver_.sent[50], (std::array<double, 2>{1, 2}));  // g(q): zero added torque
  EXPECT_EQ(driver_.sent_count, 53u);                          // 0.12 s of it
  EXPECT_EQ(outcome.recording.samples.size(), 54u);
  EXPECT_EQ(driver_.entered, (std::vector<double>{1, 2}));
}

TEST_F(ControlLoop, SubtractsGravityWhereTheBaseAddsItAndStopsWithExactlyZero) {
  driver_.info_.adds_gravity_compensation = true;
  const Outcome outcome = Run(0.4, Constant);
  EXPECT_EQ(driver_.entered, (std::vector<double>{0, 0}));
  EXPECT_EQ(driver_.sent[0], (std::array<double, 2>{2, -6}));
  EXPECT_EQ(driver_.sent[10], (std::array<double, 2>{0, 0}));
  EXPECT_EQ(outcome.recording.samples[0].command[1], -4.0);
  EXPECT_EQ(outcome.recording.samples[0].sent[1], -6.0);
}

TEST_F(ControlLoop, TheCycleAllocatesNothing) {
  const long few = Run(0.4, Constant).allocations;
  driver_ = FakeDriver();
  const long many = Run(40.0, Constant).allocations;
  EXPECT_EQ(few, many);
  EXPECT_LT(many, 100);
}

TEST_F(ControlLoop, NanOfTheControllerIsNeverSent) {
  const Outcome outcome = Run(2.0, [](double t, const double*, const double*, double* tau) {
    tau[0] = 0;
    tau[1] = t < 0.5 ? 0.0 : std::numeric_limits<double>::quiet_NaN();
  });
  EXPECT_EQ(outcome.result.trip.reason, EndReason::kControllerNan);
  EXPECT_EQ(outcome.result.trip.joint, 1);
  for (size_t i = 0; i < driver_.sent_count; ++i) EXPECT_TRUE(std::isfinite(driver_.sent[i][1]));
  EXPECT_EQ(driver_.holds, 1);
}

TEST_F(ControlLoop, StateThatStopsComingEndsTheRollout) {
  driver_.script = [](FakeDriver& d) {
    static thread_local int64_t stuck = 0;
    if (d.tick == 10) stuck = d.state.stamp_ns;
    if (d.tick >= 10) d.state.stamp_ns = stuck, --d.state.sequence;
  };
  const Outcome outcome = Run(2.0, Constant);
  EXPECT_EQ(outcome.result.trip.reason, EndReason::kStaleState);
  EXPECT_GT(outcome.result.trip.value, 0.12);
  EXPECT_LT(outcome.result.duration_s, 0.4 + 0.2);
}

TEST_F(ControlLoop, LostDriverEndsTheRolloutAndHoldIsStillTried) {
  options_.stop.attempt_s = 0.05;
  driver_.script = [](FakeDriver& d) { d.lost = d.tick == 20; };
  const Outcome outcome = Run(2.0, Constant);
  EXPECT_EQ(outcome.result.trip.reason, EndReason::kDriverLost);
  EXPECT_GE(driver_.holds, 3);
  EXPECT_FALSE(outcome.result.stop.confirmed);
  EXPECT_EQ(outcome.result.stop.attempts, 3);
  EXPECT_GE(outcome.recording.samples.size(), 19u);
}

TEST_F(ControlLoop, OperatorsStopEndsWithinOneTick) {
  driver_.script = [this](FakeDriver& d) {
    if (d.tick == 7) stop_.Cancel();
  };
  const Outcome outcome = Run(2.0, Constant);
  EXPECT_EQ(outcome.result.trip.reason, EndReason::kOperatorStop);
  EXPECT_EQ(outcome.result.commands, 7u);
}

TEST_F(ControlLoop, LateWakeUpsAreMissedDeadlinesAndTicksAreNotCaughtUp) {
  driver_.script = [](FakeDriver& d) {
    if (d.tick == 9) d.oversleep_ns = 90'000'000;  // the tenth tick: two more are gone
  };
  const Outcome outcome = Run(2.0, Constant);
  EXPECT_EQ(outcome.result.trip.reason, EndReason::kCompleted);
  EXPECT_EQ(outcome.result.jitter.missed_deadlines, 3u);
  EXPECT_EQ(outcome.result.commands, 48u);
  EXPECT_NEAR(outcome.result.jitter.lateness.max_us(), 90'000.0, 1.0);
  EXPECT_NEAR(outcome.result.duration_s, 2.0, 1e-9);
}

TEST_F(ControlLoop, DeadlinesThatPassAfterATripAreCountedToo) {
  driver_.script = [this](FakeDriver& d) {
    if (d.tick == 10) stop_.Cancel();
    if (d.tick == 11) d.oversleep_ns = 90'000'000;  // the tick after it, while zero torque is added
  };
  const Outcome outcome = Run(2.0, Constant);
  EXPECT_EQ(outcome.result.trip.reason, EndReason::kOperatorStop);
  EXPECT_EQ(outcome.result.jitter.missed_deadlines, 3u);
}

TEST_F(ControlLoop, ManyLateWakeUpsInARowEndTheRollout) {
  driver_.script = [](FakeDriver& d) { d.oversleep_ns = d.tick >= 10 ? 25'000'000 : 0; };
  const Outcome outcome = Run(2.0, Constant);
  EXPECT_EQ(outcome.result.trip.reason, EndReason::kMissedDeadlines);
}

TEST_F(ControlLoop, RefusedTorqueModeIsNoRollout) {
  driver_.refuse = true;
  const Outcome outcome = Run(2.0, Constant);
  EXPECT_EQ(outcome.result.trip.reason, EndReason::kNotStarted);
  EXPECT_EQ(driver_.sent_count, 0u);
  EXPECT_EQ(driver_.holds, 1);
}

TEST_F(ControlLoop, DifferencedVelocityComesFromPositionsAndTheirStamps) {
  options_.velocity_source = VelocitySource::kDifferenced;
  driver_.script = [](FakeDriver& d) {
    d.state.q[0] = 0.5e-9 * static_cast<double>(d.state.stamp_ns - 1'000'000'000);
    d.state.v[0] = 1.9;
  };
  double seen = 0;
  Run(0.4, [&](double t, const double*, const double* v, double* tau) {
    tau[0] = tau[1] = 0;
    if (t > 0.1) seen = v[0];
  });
  EXPECT_NEAR(seen, 0.5, 1e-9);
}

TEST_F(ControlLoop, TheFirstTorqueIsCheckedBeforeItIsSent) {
  limits_.torque = {10, 1.5};  // gravity of joint b is 2
  const Outcome outcome = Run(2.0, Constant);
  EXPECT_EQ(outcome.result.trip.reason, EndReason::kTorqueLimit);
  EXPECT_EQ(outcome.result.trip.joint, 1);
  EXPECT_TRUE(driver_.entered.empty()) << "torque mode was asked for";
  EXPECT_FALSE(outcome.result.entered);
  EXPECT_EQ(driver_.sent_count, 0u);
}

TEST_F(ControlLoop, AnArmOutsideItsBoxesNeverEntersTorqueMode) {
  driver_.state.q[0] = 1.1;
  const Outcome outcome = Run(2.0, Constant);
  EXPECT_EQ(outcome.result.trip.reason, EndReason::kPositionLimit);
  EXPECT_TRUE(driver_.entered.empty());
  driver_.state.q[0] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(Run(2.0, Constant).result.trip.reason, EndReason::kRobotNan);
  EXPECT_TRUE(driver_.entered.empty());
}

TEST_F(ControlLoop, TheMonitorDoesNotBelieveTheArmsVelocity) {
  driver_.script = [](FakeDriver& d) {
    d.state.v[0] = 0.0;  // says so, and moves at 2.5 rad/s, limit 2, from the tenth tick on
    if (d.tick > 10) d.state.q[0] += 2.5 * 0.04;
  };
  limits_.jump_ratio = 3;
  const Outcome outcome = Run(2.0, Constant);
  EXPECT_EQ(outcome.result.trip.reason, EndReason::kVelocityLimit);
  EXPECT_NEAR(outcome.result.trip.value, 2.5, 1e-9);
  EXPECT_EQ(outcome.result.commands, 11u) << "the first state that shows it stops the arm";
}

TEST_F(ControlLoop, ALyingVelocityOfTheArmStopsNothing) {
  driver_.script = [](FakeDriver& d) { d.state.v[0] = 6.28; };
  EXPECT_EQ(Run(1.0, Constant).result.trip.reason, EndReason::kCompleted);
}

TEST_F(ControlLoop, PositionsThatFreezeWhileTheArmMovesStopIt) {
  driver_.state.q[1] = 0.2;
  driver_.script = [](FakeDriver& d) {
    d.state.q[1] = 0.2;
    if (d.tick <= 10) d.state.q[0] = 0.5 * 0.04 * d.tick;
  };
  const Outcome outcome = Run(2.0, Constant);
  EXPECT_EQ(outcome.result.trip.reason, EndReason::kFrozenState);
  EXPECT_LT(outcome.result.duration_s, 0.4 + 0.12 + 0.08) << "within two periods of the limit";
}

TEST_F(ControlLoop, AStopThatCannotBeSeenIsNotConfirmed) {
  driver_.script = [](FakeDriver& d) {
    if (d.state.mode == Mode::kPosition) d.state.q[0] += 0.05 * 0.02;  // it creeps on at 0.05 rad/s
  };
  const Outcome outcome = Run(0.4, Constant);
  EXPECT_EQ(outcome.result.trip.reason, EndReason::kCompleted);
  EXPECT_FALSE(outcome.result.stop.confirmed);
  EXPECT_EQ(driver_.holds, 3);
  EXPECT_NEAR(outcome.result.stop.worst_speed, 0.05, 1e-3);
}

// What a stop is waited for by those who could end its process: an arm whose every call hangs, and that never rests.
TEST_F(ControlLoop, NoStopTakesLongerThanItsBound) {
  const StopOptions options;
  driver_.hold_takes_ns = std::llround(1e9 * options.call_s);
  driver_.script = [](FakeDriver& d) { d.state.q[0] += 0.01; };
  const StopReport restless = StopArm(driver_, options);
  EXPECT_FALSE(restless.confirmed);
  EXPECT_EQ(restless.attempts, options.attempts);
  EXPECT_GT(restless.took_s, options.attempts * options.call_s);
  EXPECT_LT(restless.took_s, LongestStop(options));
  EXPECT_GT(LongestEnd(options), kLongestEntry + LongestStop(options));
}

TEST_F(ControlLoop, CommandsThatChangeTooFastAreLimited) {
  limits_.torque_rate = {50, 50};  // 2 N·m per tick
  const Outcome outcome = Run(0.4, [](double t, const double*, const double*, double* tau) {
    tau[0] = t < 0.1 ? 1.0 : 7.0;
    tau[1] = 2.0;
  });
  EXPECT_EQ(driver_.sent[2][0], 1.0);
  EXPECT_NEAR(driver_.sent[3][0], 3.0, 1e-9);
  EXPECT_NEAR(driver_.sent[4][0], 5.0, 1e-9);
  EXPECT_EQ(driver_.sent[5][0], 7.0);
  EXPECT_EQ(outcome.result.saturated_samples, 2u);
}

TEST_F(ControlLoop, SaturationIsCountedAndMarkedInTheRecording) {
  const Outcome outcome = Run(0.4, [](double t, const double*, const double*, double* tau) {
    tau[0] = t < 0.1 ? 15.0 : 1.0;
    tau[1] = 0;
  });
  EXPECT_EQ(outcome.result.saturated_samples, 3u);
  EXPECT_EQ(outcome.recording.samples[0].command[0], 10.0);
  EXPECT_TRUE(outcome.recording.samples[0].flags & Sample::kSaturated);
  EXPECT_FALSE(outcome.recording.samples[5].flags & Sample::kSaturated);
}

}  // namespace
}  // namespace rg::robot_agent
