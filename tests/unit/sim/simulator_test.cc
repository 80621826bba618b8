#include "common/sim/simulator.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "tests/support/sim/plants.h"

namespace rg::sim {
namespace {

using effects::MakeSpec;
using rg::testing::JointNames;
using rg::testing::LoadRobot;
using rg::testing::MakePlant;

Eigen::VectorXd Values(const Simulator& simulator, const std::map<std::string, double>& changes) {
  Eigen::VectorXd p = simulator.plant().parameters().Nominal();
  for (const auto& [name, value] : changes) p[simulator.plant().parameters().IndexOf(name).value()] = value;
  return p;
}

// A rotor of inertia J without gravity or damping: q̈ = τ/J.
struct Rotor {
  explicit Rotor(std::vector<effects::EffectSpec> effects = {})
      : plant(MakePlant("pendulum", std::move(effects))), simulator(plant) {
    simulator.SetParameters(Values(simulator, {{"gravity.z", 0.0}, {"damping.hinge", 0.0}}));
    Eigen::VectorXd zero = Eigen::VectorXd::Zero(1), a(1);
    const Plant rigid = MakePlant("pendulum");
    Simulator s(rigid);
    s.SetParameters(Values(s, {{"gravity.z", 0.0}, {"damping.hinge", 0.0}}));
    EXPECT_TRUE(s.Acceleration(s.MakeState(zero, zero), Eigen::VectorXd::Ones(1), &a));
    inertia = 1.0 / a[0];
  }
  Plant plant;
  Simulator simulator;
  double inertia;
};

const Eigen::VectorXd kZero = Eigen::VectorXd::Zero(1);

CommandSignal Steps(int n, double period, int count) {
  std::vector<double> times;
  Eigen::MatrixXd u(n, count);
  for (int k = 0; k < count; ++k) {
    times.push_back(period * k);
    for (int i = 0; i < n; ++i) u(i, k) = 0.4 * std::sin(1.3 * k + i);
  }
  return CommandSignal::Create(times, u, Hold::kZeroOrder).value();
}

TEST(Simulate, GivesTheSameForSplitIntervals) {
  const auto joints = JointNames(*LoadRobot("mico2"));
  const Plant plant = MakePlant("mico2", {MakeSpec("coulomb_friction", joints, {{"coulomb", 0.2}}),
                                          MakeSpec("actuator_delay", joints, {{"delay", 0.004}})});
  Simulator simulator(plant);
  const State x0 = simulator.MakeState(Eigen::VectorXd::Constant(6, 1.5), Eigen::VectorXd::Zero(6));
  const CommandSignal command = Steps(6, 0.04, 10);
  const Trajectory whole = simulator.Simulate(x0, command, {0.1, 0.2});
  const Trajectory first = simulator.Simulate(x0, command, {0.1});
  State middle = x0;
  middle.q = first.state.col(0).head(6);
  middle.v = first.state.col(0).segment(6, 6);
  middle.time = 0.1;
  const Trajectory second = simulator.Simulate(middle, command, {0.2});
  EXPECT_LT((whole.state.col(1) - second.state.col(0)).cwiseAbs().maxCoeff(), 1e-11);
}

TEST(Simulate, AgreesWithAdvanceUnderHeldCommands) {
  const auto joints = JointNames(*LoadRobot("mico2"));
  const Plant plant = MakePlant("mico2", {MakeSpec("actuator_lag", joints, {{"time_constant", 0.02}}),
                                          MakeSpec("actuator_delay", joints, {{"delay", 0.013}}),
                                          MakeSpec("sensor_delay", joints, {{"delay", 0.006}}),
                                          MakeSpec("encoder_offset", joints, {{"offset", 0.01}})});
  Simulator simulator(plant);
  const CommandSignal command = Steps(6, 0.04, 10);
  const Eigen::VectorXd q = Eigen::VectorXd::Constant(6, 1.5), v = Eigen::VectorXd::Zero(6);
  const State x0 = simulator.MakeState(q, v, 0.0, command);
  const Trajectory out = simulator.Simulate(x0, command, {0.04, 0.08, 0.12, 0.16});
  State x = x0;
  Eigen::VectorXd measured_q, measured_v;
  for (int k = 0; k < 4; ++k) {
    ASSERT_TRUE(simulator.Advance(x, command.values().col(k), 0.04).ok());
    EXPECT_LT((x.Stacked() - out.state.col(k)).cwiseAbs().maxCoeff(), 1e-9) << k;
  }
  // The sensor's past is known at the ends of intervals only: interpolation over 40 ms.
  simulator.Measure(x, &measured_q, &measured_v);
  EXPECT_LT((measured_q - out.position.col(3)).cwiseAbs().maxCoeff(), 2e-3);
}

TEST(Simulate, StopsAtNonFiniteCommandsWithStepTimeAndJoint) {
  const Plant plant = MakePlant("arm2");
  Simulator simulator(plant);
  State x = simulator.MakeState(Eigen::VectorXd::Zero(2), Eigen::VectorXd::Zero(2));
  const State before = x;
  Eigen::Vector2d u(0.0, std::numeric_limits<double>::quiet_NaN());
  const Outcome outcome = simulator.Advance(x, u, 0.01);
  EXPECT_EQ(outcome.kind, Outcome::Kind::kNonFinite);
  EXPECT_EQ(outcome.joint, "elbow");
  EXPECT_EQ(outcome.step, 0);
  EXPECT_EQ(x.q, before.q);
  EXPECT_EQ(x.time, before.time);
}

TEST(Simulate, SaysWhereTheMassMatrixIsNotPositive) {
  const Plant plant = MakePlant("arm2");
  Simulator simulator(plant);
  simulator.SetParameters(Values(simulator, {{"mass.forearm", -1.0}}));
  const State x = simulator.MakeState(Eigen::VectorXd::Zero(2), Eigen::VectorXd::Zero(2));
  const Trajectory out = simulator.Simulate(x, CommandSignal::Constant(Eigen::VectorXd::Zero(2)), {0.1});
  EXPECT_EQ(out.outcome.kind, Outcome::Kind::kMassMatrixNotPositive) << out.outcome.ToString();
  EXPECT_EQ(out.reached, 0);
  EXPECT_TRUE(std::isnan(out.position(0, 0)));
}

TEST(ActuatorLag, FollowsTheExponentialExactly) {
  constexpr double kT = 0.03;
  Rotor rotor({MakeSpec("actuator_lag", {"hinge"}, {{"time_constant", kT}})});
  State x = rotor.simulator.MakeState(kZero, kZero);
  const Eigen::VectorXd u = Eigen::VectorXd::Constant(1, 0.2);
  ASSERT_TRUE(rotor.simulator.Advance(x, u, 0.1).ok());
  const double e = std::exp(-0.1 / kT);
  EXPECT_NEAR(x.z[0], 0.2 * (1 - e), 1e-9);
  EXPECT_NEAR(x.v[0], 0.2 / rotor.inertia * (0.1 - kT * (1 - e)), 1e-6);
}

TEST(ActuatorDelay, ShiftsARampByTheDelay) {
  constexpr double kT = 0.0137;
  Rotor rotor({MakeSpec("actuator_delay", {"hinge"}, {{"delay", kT}})});
  const CommandSignal ramp =
      CommandSignal::Create({0.0, 1.0}, (Eigen::MatrixXd(1, 2) << 0.0, 1.0).finished(), Hold::kLinear)
          .value();
  const State x0 = rotor.simulator.MakeState(kZero, kZero);
  const Trajectory out = rotor.simulator.Simulate(x0, ramp, {0.5});
  EXPECT_NEAR(out.velocity(0, 0), 0.5 * std::pow(0.5 - kT, 2) / rotor.inertia, 1e-9);
}

TEST(ActuatorDelay, OfAHeldCommandActsInsideAStep) {
  Rotor rotor({MakeSpec("actuator_delay", {"hinge"}, {{"delay", 0.0105}})});
  State x = rotor.simulator.MakeState(kZero, kZero);
  ASSERT_TRUE(rotor.simulator.Advance(x, kZero, 0.01).ok());
  ASSERT_TRUE(rotor.simulator.Advance(x, Eigen::VectorXd::Ones(1), 0.02).ok());
  EXPECT_NEAR(x.v[0], (0.02 - 0.0105) / rotor.inertia, 1e-9);
}

TEST(SensorDelay, ReportsThePast) {
  Rotor rotor({MakeSpec("sensor_delay", {"hinge"}, {{"delay", 0.0137}})});
  const State x0 = rotor.simulator.MakeState(kZero, Eigen::VectorXd::Ones(1));
  const Trajectory out = rotor.simulator.Simulate(x0, CommandSignal::Constant(kZero), {0.0, 0.01, 0.1});
  EXPECT_NEAR(out.position(0, 0), -0.0137, 1e-12);
  EXPECT_NEAR(out.position(0, 1), 0.01 - 0.0137, 1e-12);
  EXPECT_NEAR(out.position(0, 2), 0.1 - 0.0137, 1e-12);
}

TEST(SensorDelay, FollowsAnAcceleratedMotionBackBeyondItsStart) {
  constexpr double kDelay = 0.0137, kSpeed = 0.3, kNudge = 1e-6;
  Rotor rotor({MakeSpec("sensor_delay", {"hinge"}, {{"delay", kDelay}})});
  const Eigen::VectorXd one = Eigen::VectorXd::Ones(1);
  const CommandSignal command = CommandSignal::Constant(one);
  const State x0 = rotor.simulator.MakeState(kZero, kSpeed * one);
  const int delay = rotor.plant.parameters().Find("sensor_delay.hinge.delay");
  const std::vector<double> times = {0.0, 0.01, 0.02};
  const Trajectory out =
      rotor.simulator.Simulate(x0, command, times, {.initial_state = true, .parameters = {delay}});
  const double a = 1.0 / rotor.inertia;
  for (int k = 0; k < 3; ++k) {
    const double t = times[k] - kDelay;
    EXPECT_NEAR(out.position(0, k), kSpeed * t + 0.5 * a * t * t, 1e-9) << k;
    EXPECT_NEAR(out.velocity(0, k), kSpeed + a * t, 1e-9) << k;
    EXPECT_NEAR(out.dposition(k, 2), -out.velocity(0, k), 1e-9) << k;
    EXPECT_NEAR(out.dvelocity(k, 2), -a, 1e-9) << k;
  }
  const State nudged = rotor.simulator.MakeState(kZero, (kSpeed + kNudge) * one);
  const Trajectory other = rotor.simulator.Simulate(nudged, command, times);
  for (int k = 0; k < 3; ++k) {
    EXPECT_NEAR(out.dposition(k, 1), (other.position(0, k) - out.position(0, k)) / kNudge, 1e-7) << k;
    EXPECT_NEAR(out.dvelocity(k, 1), (other.velocity(0, k) - out.velocity(0, k)) / kNudge, 1e-7) << k;
  }
}

// A window that starts in the middle of a run says of its late rows what the whole run says.
TEST(SensorDelay, LooksBackUnderTheCommandsOfThen) {
  Rotor rotor({MakeSpec("sensor_delay", {"hinge"}, {{"delay", 0.025}})});
  const CommandSignal command = Steps(1, 0.02, 10);
  const State x0 = rotor.simulator.MakeState(kZero, kZero);
  const Trajectory whole = rotor.simulator.Simulate(x0, command, {0.1, 0.11, 0.12, 0.13});
  State middle = x0;
  middle.q = whole.state.col(0).head(1);
  middle.v = whole.state.col(0).tail(1);
  middle.time = 0.1;
  const Trajectory window = rotor.simulator.Simulate(middle, command, {0.1, 0.11, 0.12, 0.13});
  for (int k = 0; k < 4; ++k) {
    // Exact in velocity; in position to the lever of a change of command inside the time looked back.
    EXPECT_NEAR(window.velocity(0, k), whole.velocity(0, k), 1e-9) << k;
    const double lever = 0.025 * 0.025 / 8 * 0.8 / rotor.inertia;
    EXPECT_NEAR(window.position(0, k), whole.position(0, k), lever) << k;
  }
}

TEST(MakeStateFromMeasurement, IsMeasuredAsWhatItWasMadeFrom) {
  auto elastic = MakeSpec("joint_elasticity", {"elbow"}, {{"stiffness", 200}, {"motor_inertia", 0.1}});
  elastic.options["sensor"] = "motor";
  const Plant plant =
      MakePlant("arm2", {elastic, MakeSpec("encoder_offset", {"shoulder", "elbow"}, {{"offset", 0.03}}),
                         MakeSpec("sensor_delay", {"shoulder"}, {{"delay", 0.02}})});
  Simulator simulator(plant);
  Eigen::VectorXd q(2), v(2), u(2), measured_q, measured_v;
  q << 0.4, -0.7;
  v << 0.5, 0.2;
  u << 1.0, 3.0;
  const State x = simulator.MakeStateFromMeasurement(q, v, 0.0, CommandSignal::Constant(u));
  EXPECT_NEAR(x.z[0] - x.q[1], 3.0 / 200, 1e-12);  // the spring holds the drive's torque
  simulator.Measure(x, &measured_q, &measured_v);
  EXPECT_LT((measured_q - q).norm(), 1e-12);
  EXPECT_LT((measured_v - v).norm(), 1e-12);
  const Trajectory out = simulator.Simulate(x, CommandSignal::Constant(u), {0.0});
  EXPECT_LT((out.position.col(0) - q).norm(), 1e-12);
}

TEST(RotorInertia, AddsToTheJoint) {
  Rotor rotor({MakeSpec("rotor_inertia", {"hinge"}, {{"armature", 0.25}})});
  State x = rotor.simulator.MakeState(kZero, kZero);
  ASSERT_TRUE(rotor.simulator.Advance(x, Eigen::VectorXd::Ones(1), 0.1).ok());
  EXPECT_NEAR(x.v[0], 0.1 / (rotor.inertia + 0.25), 1e-12);
}

TEST(ViscousFriction, DecaysExponentially) {
  Rotor rotor({MakeSpec("viscous_friction", {"hinge"}, {{"viscous", 0.5}})});
  State x = rotor.simulator.MakeState(kZero, Eigen::VectorXd::Ones(1));
  ASSERT_TRUE(rotor.simulator.Advance(x, kZero, 0.2).ok());
  EXPECT_NEAR(x.v[0], std::exp(-0.5 / rotor.inertia * 0.2), 1e-5);
  EXPECT_NEAR(x.q[0], (1 - x.v[0]) * rotor.inertia / 0.5, 1e-5);
}

TEST(CoulombFriction, SlowsReversesAndSticksInClosedForm) {
  constexpr double kC = 0.1, kTau = -0.25;
  Rotor rotor({MakeSpec("coulomb_friction", {"hinge"}, {{"coulomb", kC}})});
  State x = rotor.simulator.MakeState(kZero, Eigen::VectorXd::Constant(1, 0.8137));
  const Eigen::VectorXd u = Eigen::VectorXd::Constant(1, kTau);
  ASSERT_TRUE(rotor.simulator.Advance(x, u, 0.5).ok());
  const double stop = 0.8137 * rotor.inertia / (kC - kTau);  // time to rest
  EXPECT_NEAR(x.v[0], (kTau + kC) / rotor.inertia * (0.5 - stop), 2e-6);
}

TEST(JointElasticity, RingsAtTheResonanceOfBothSides) {
  constexpr double kK = 120.0, kJ = 0.04;
  Rotor rotor({MakeSpec("joint_elasticity", {"hinge"},
                        {{"stiffness", kK}, {"damping", 0.0}, {"motor_inertia", kJ}})});
  State x = rotor.simulator.MakeState(kZero, kZero);
  x.z[0] = 0.01;  // the motor is turned away and let go
  const double omega = std::sqrt(kK * (1 / kJ + 1 / rotor.inertia));
  const double period = 2 * M_PI / omega;
  ASSERT_TRUE(rotor.simulator.Advance(x, kZero, 3 * period).ok());
  EXPECT_NEAR(x.z[0] - x.q[0], 0.01, 2e-4);
}

TEST(Backlash, LetsTheMotorTurnFreelyThroughTheGap) {
  Rotor rotor(
      {MakeSpec("backlash", {"hinge"},
                {{"gap", 0.02}, {"contact_stiffness", 1e4}, {"contact_damping", 5}, {"motor_inertia", 0.05}}),
       MakeSpec("viscous_friction", {"hinge"}, {{"viscous", 0.5}})});
  State x = rotor.simulator.MakeState(kZero, kZero);
  const Eigen::VectorXd u = Eigen::VectorXd::Constant(1, 0.05);
  ASSERT_TRUE(rotor.simulator.Advance(x, u, 0.1).ok());  // ½·1·0.01 = 5 mrad: still in the gap
  EXPECT_EQ(x.q[0], 0.0);
  EXPECT_NEAR(x.z[0], 0.005, 1e-9);
  ASSERT_TRUE(rotor.simulator.Advance(x, u, 0.9).ok());
  EXPECT_NEAR(x.z[0] - x.q[0], 0.01, 1e-4);  // pushing at the face
}

TEST(GravityMisalignment, TurnsGravityAsTheContractSays) {
  const double tilt = 0.2, azimuth = 0.7;
  const Plant tilted =
      MakePlant("arm2", {MakeSpec("gravity_misalignment", {}, {{"tilt", tilt}, {"azimuth", azimuth}})});
  PlantOptions options;
  options.gravity = 9.81 * Eigen::Vector3d(std::sin(tilt) * std::cos(azimuth),
                                           std::sin(tilt) * std::sin(azimuth), -std::cos(tilt));
  const Plant direct = MakePlant("arm2", {}, options);
  Simulator a(tilted), b(direct);
  Eigen::VectorXd q(2), acceleration_a, acceleration_b;
  q << 0.3, -0.8;
  const Eigen::VectorXd zero = Eigen::VectorXd::Zero(2);
  ASSERT_TRUE(a.Acceleration(a.MakeState(q, zero), zero, &acceleration_a));
  ASSERT_TRUE(b.Acceleration(b.MakeState(q, zero), zero, &acceleration_b));
  // arm2's own gravity parameters are (0, 0, −9.81).
  EXPECT_LT((acceleration_a - acceleration_b).norm(), 1e-9);
}

TEST(SloshingPayload, SagsUnderItsWeight) {
  const Plant plant = MakePlant(
      "pendulum", {MakeSpec("sloshing_payload", {}, {{"mass", 0.5}, {"stiffness", 50}, {"damping", 3}}),
                   MakeSpec("coulomb_friction", {"hinge"}, {{"coulomb", 50}})});
  Simulator simulator(plant);
  State x = simulator.MakeState(kZero, kZero);
  ASSERT_TRUE(simulator.Advance(x, kZero, 5.0).ok());
  double sag = 0.0;
  for (int k = 0; k < x.z.size(); ++k) {
    if (plant.internal_state_names()[k].rfind("position.slosh", 0) == 0) sag += x.z[k] * x.z[k];
  }
  EXPECT_NEAR(std::sqrt(sag), 0.5 * 9.81 / 50, 1e-4);
}

TEST(BaseFlexibility, LeansUnderTheArm) {
  const Plant plant =
      MakePlant("arm2", {MakeSpec("base_flexibility", {}, {{"stiffness", 500}, {"damping", 40}}),
                         MakeSpec("coulomb_friction", {"shoulder", "elbow"}, {{"coulomb", 200}})});
  Simulator simulator(plant);
  Eigen::VectorXd q(2);
  q << M_PI / 2, 0.0;
  State x = simulator.MakeState(q, Eigen::VectorXd::Zero(2));
  ASSERT_TRUE(simulator.Advance(x, Eigen::VectorXd::Zero(2), 5.0).ok());
  // The joints stick; the mount carries the gravity torque that the shoulder would.
  double lean = 0.0;
  for (int k = 0; k < x.z.size(); ++k) {
    if (plant.internal_state_names()[k] == "position.base_tilt_y") lean = x.z[k];
  }
  EXPECT_GT(std::abs(lean), 5e-3);
  EXPECT_LT((x.q - q).norm(), 1e-5);
}

TEST(Contact, CarriesTheArmOnASoftFloor) {
  auto floor = MakeSpec("contact", {}, {{"stiffness", 2000}, {"damping", 50}, {"height", 0.0}});
  const Plant plant =
      MakePlant("arm2", {floor, MakeSpec("viscous_friction", {"shoulder", "elbow"}, {{"viscous", 2}})});
  Simulator simulator(plant);
  State x = simulator.MakeState(Eigen::Vector2d(1.0, 0.2), Eigen::VectorXd::Zero(2));
  ASSERT_TRUE(simulator.Advance(x, Eigen::VectorXd::Zero(2), 5.0).ok());
  EXPECT_LT(x.v.norm(), 1e-3);  // it rests on something
}

TEST(Mico, OneMillisecondIsCloseToAFiftiethOfIt) {
  const auto joints = JointNames(*LoadRobot("mico2"));
  const Plant plant = MakePlant("mico2", {MakeSpec("viscous_friction", joints, {{"viscous", 0.5}}),
                                          MakeSpec("coulomb_friction", joints, {{"coulomb", 0.3}}),
                                          MakeSpec("rotor_inertia", joints, {{"armature", 0.02}})});
  Eigen::VectorXd q(6);
  q << 0.0, 2.8, 2.6, 0.3, 0.2, 0.1;
  auto end = [&](double step) {
    SimulatorOptions options;
    options.step_s = step;
    Simulator simulator(plant, options);
    return Eigen::VectorXd(
        simulator.Simulate(simulator.MakeState(q, Eigen::VectorXd::Zero(6)), Steps(6, 0.04, 26), {1.0})
            .position.col(0));
  };
  const double error = (end(1e-3) - end(2e-5)).cwiseAbs().maxCoeff();
  RecordProperty("error_rad", std::to_string(error));
  EXPECT_LT(error, 1e-4);
}

}  // namespace
}  // namespace rg::sim
