// Order, energy, stiffness and sticking of the integrators, through the simulator.
#include <gtest/gtest.h>

#include <cmath>

#include "common/dynamics/dynamics.h"
#include "common/sim/simulator.h"
#include "tests/support/sim/plants.h"

namespace rg::sim {
namespace {

using effects::MakeSpec;
using rg::testing::JointNames;
using rg::testing::LoadRobot;
using rg::testing::MakePlant;

SimulatorOptions With(Integrator integrator, double step) {
  SimulatorOptions options;
  options.integrator = integrator;
  options.step_s = step;
  return options;
}

Eigen::VectorXd Folded(int n) {
  Eigen::VectorXd q(n);
  for (int i = 0; i < n; ++i) q[i] = 0.9 + 0.35 * i;
  return q;
}

// A command that moves inside the steps enters them as its average, which is of second order; held ones are
// exact.
CommandSignal Held(int n) { return CommandSignal::Constant(Eigen::VectorXd::LinSpaced(n, 1.0, 0.4)); }

CommandSignal Smooth(int n) {
  std::vector<double> times;
  Eigen::MatrixXd u(n, 201);
  for (int k = 0; k <= 200; ++k) {
    times.push_back(0.01 * k);
    for (int i = 0; i < n; ++i) u(i, k) = 1.5 / (1 + i) * std::sin(0.05 * k + i);
  }
  return CommandSignal::Create(times, u, Hold::kLinear).value();
}

// Position after one second.
Eigen::VectorXd End(const Plant& plant, Integrator integrator, double step) {
  Simulator simulator(plant, With(integrator, step));
  const int n = plant.num_joints();
  const State x0 = simulator.MakeState(Folded(n), Eigen::VectorXd::Zero(n));
  const Trajectory out = simulator.Simulate(x0, integrator == Integrator::kRk4 ? Held(n) : Smooth(n), {1.0});
  EXPECT_TRUE(out.outcome.ok()) << out.outcome.ToString();
  return out.position.col(0);
}

// Error against a much finer run, at h and h/2, as an order.
double ObservedOrder(const Plant& plant, Integrator integrator, double h, Integrator fine) {
  const Eigen::VectorXd truth = End(plant, fine, h / 32);
  const double coarse = (End(plant, integrator, h) - truth).norm();
  const double half = (End(plant, integrator, h / 2) - truth).norm();
  return std::log2(coarse / half);
}

TEST(Convergence, SemiImplicitEulerIsOfFirstOrder) {
  const Plant plant = MakePlant("arm2");
  EXPECT_NEAR(ObservedOrder(plant, Integrator::kSemiImplicitEuler, 2e-3, Integrator::kLeapfrog), 1.0, 0.1);
}

TEST(Convergence, LeapfrogIsOfSecondOrder) {
  const Plant plant = MakePlant("arm2");
  EXPECT_NEAR(ObservedOrder(plant, Integrator::kLeapfrog, 4e-3, Integrator::kLeapfrog), 2.0, 0.1);
}

TEST(Convergence, Rk4IsOfFourthOrder) {
  const Plant plant = MakePlant("arm2");
  EXPECT_NEAR(ObservedOrder(plant, Integrator::kRk4, 2e-2, Integrator::kRk4), 4.0, 0.4);
}

TEST(Convergence, LeapfrogStaysOfSecondOrderWithSmoothEffects) {
  const auto joints = JointNames(*LoadRobot("arm2"));
  const Plant plant = MakePlant(
      "arm2",
      {MakeSpec("viscous_friction", joints, {{"viscous", 1.0}}),
       MakeSpec("quadratic_drag", joints, {{"quadratic", 0.4}}),
       MakeSpec("rotor_inertia", joints, {{"armature", 0.05}}),
       MakeSpec("position_spring", joints, {{"stiffness", 6}}),
       MakeSpec("actuator_lag", joints, {{"time_constant", 0.02}}),
       MakeSpec("joint_elasticity", {"elbow"}, {{"stiffness", 300}, {"damping", 1}, {"motor_inertia", 0.1}}),
       MakeSpec("torque_ripple", joints, {{"amplitude", 0.2}, {"cycles_per_rev", 8}})});
  EXPECT_NEAR(ObservedOrder(plant, Integrator::kLeapfrog, 2e-3, Integrator::kLeapfrog), 2.0, 0.15);
}

TEST(Convergence, CoulombReversalsCostNoOrder) {
  const auto joints = JointNames(*LoadRobot("arm2"));
  const Plant plant = MakePlant("arm2", {MakeSpec("coulomb_friction", joints, {{"coulomb", 0.6}})});
  const Eigen::VectorXd truth = End(plant, Integrator::kLeapfrog, 2e-5);
  // 1 ms stays within 20 µrad of 0.02 ms over a second with reversals; a force taken at the step's end
  // would be off by milliradians.
  EXPECT_LT((End(plant, Integrator::kLeapfrog, 1e-3) - truth).cwiseAbs().maxCoeff(), 2e-5);
}

// The worst deviation of a free arm's energy over ten seconds [J].
double EnergyDrift(Integrator integrator, double step) {
  auto model = LoadRobot("arm2");
  const Plant plant = MakePlant("arm2");
  Simulator simulator(plant, With(integrator, step));
  Eigen::VectorXd p = plant.parameters().Nominal();
  for (const int i : plant.parameters().OfKind(ParameterKind::kDamping)) p[i] = 0.0;
  simulator.SetParameters(p);
  dynamics::Mechanism mechanism(*model);
  dynamics::Workspace workspace;
  auto energy = [&](const State& x) {
    return dynamics::KineticEnergy(mechanism, workspace, x.q, x.v) +
           dynamics::PotentialEnergy(mechanism, workspace, x.q);
  };
  State x = simulator.MakeState(Folded(2), Eigen::VectorXd::Zero(2));
  const double start = energy(x);
  double worst = 0.0;
  for (int k = 0; k < 100; ++k) {
    EXPECT_TRUE(simulator.Advance(x, Eigen::VectorXd::Zero(2), 0.1).ok());
    worst = std::max(worst, std::abs(energy(x) - start));
  }
  return worst;
}

// docs/figures.md has the figures (integrator_figures).
TEST(Energy, OfAFreeArmDriftsLittleOverTenSecondsAndByTheOrderOfTheStep) {
  const double leapfrog = EnergyDrift(Integrator::kLeapfrog, 1e-3);
  EXPECT_LT(leapfrog, 2e-3);
  EXPECT_NEAR(EnergyDrift(Integrator::kLeapfrog, 2e-3) / leapfrog, 4.0, 1.0);
  const double euler = EnergyDrift(Integrator::kSemiImplicitEuler, 1e-3);
  EXPECT_GT(euler, 10 * leapfrog) << "first order";
  EXPECT_LT(euler, 1.0);
  EXPECT_LT(EnergyDrift(Integrator::kRk4, 1e-3), 1e-2 * leapfrog);
}

TEST(Pendulum, SwingsWithThePeriodOfTheEllipticIntegral) {
  const Plant plant = MakePlant("pendulum");
  Simulator simulator(plant);
  Eigen::VectorXd p = plant.parameters().Nominal();
  for (const int i : plant.parameters().OfKind(ParameterKind::kDamping)) p[i] = 0.0;
  simulator.SetParameters(p);
  const double amplitude = 1.0;
  Eigen::VectorXd a(1), zero = Eigen::VectorXd::Zero(1), q(1);
  auto acceleration = [&](double at) {
    q[0] = at;
    EXPECT_TRUE(simulator.Acceleration(simulator.MakeState(q, zero), zero, &a));
    return a[0];
  };
  // θ̈ = −ω² sin(θ − rest)
  const double rest = acceleration(0.1) > 0 ? M_PI : 0.0;
  const double omega = std::sqrt(-acceleration(rest + M_PI / 2));
  double mean = 1.0, shrink = std::cos(amplitude / 2);  // arithmetic-geometric mean
  for (int i = 0; i < 8; ++i) {
    const double next = 0.5 * (mean + shrink);
    shrink = std::sqrt(mean * shrink);
    mean = next;
  }
  const double period = 2 * M_PI / (omega * mean);
  q[0] = rest + amplitude;
  const State x0 = simulator.MakeState(q, zero);
  const Trajectory out =
      simulator.Simulate(x0, CommandSignal::Constant(zero), {period / 2, period, 5 * period});
  EXPECT_NEAR(out.position(0, 0), rest - amplitude, 2e-6);
  EXPECT_NEAR(out.position(0, 1), rest + amplitude, 2e-6);
  EXPECT_NEAR(out.position(0, 2), rest + amplitude, 2e-5);
}

TEST(Stiffness, WristWithStrongDampingStandsAtOneMillisecond) {
  const auto joints = JointNames(*LoadRobot("mico2"));
  const Plant plant = MakePlant("mico2", {MakeSpec("viscous_friction", joints, {{"viscous", 15.0}})});
  Simulator simulator(plant);
  const Eigen::VectorXd v = Eigen::VectorXd::Constant(6, 2.0);
  State x = simulator.MakeState(Folded(6), v);
  ASSERT_TRUE(simulator.Advance(x, Eigen::VectorXd::Constant(6, 1.5), 0.5).ok());
  // Quasi-static: the wrist, inertia 8e-4, moves at (torque − gravity)/damping.
  EXPECT_NEAR(x.v[5], 1.5 / 15.0, 0.02);
}

TEST(Stiffness, ElasticJointsOnLightLinksStandAtOneMillisecond) {
  const auto joints = JointNames(*LoadRobot("mico2"));
  const Plant plant = MakePlant(
      "mico2",
      {MakeSpec("joint_elasticity", joints, {{"stiffness", 1e4}, {"damping", 1}, {"motor_inertia", 0.1}}),
       MakeSpec("viscous_friction", joints, {{"viscous", 2.0}})});
  Simulator simulator(plant);
  State x = simulator.MakeState(Folded(6), Eigen::VectorXd::Zero(6));
  ASSERT_TRUE(simulator.Advance(x, Eigen::VectorXd::Constant(6, 0.5), 2.0).ok());
  for (int i = 0; i < 6; ++i) EXPECT_LT(std::abs(x.z[2 * i] - x.q[i]), 0.01) << i;  // the spring hardly bends
}

// Everything that is stiff at once, on links as light as 8e-4 kg·m²: friction 15 N·m·s/rad, springs of 1e4
// N·m/rad, dry friction that holds the arm.
TEST(Stiffness, DampingSpringsAndDryFrictionTogetherComeToRestAndStay) {
  const auto joints = JointNames(*LoadRobot("mico2"));
  const Plant plant = MakePlant(
      "mico2",
      {MakeSpec("viscous_friction", joints, {{"viscous", 15.0}}),
       MakeSpec("coulomb_friction", joints, {{"coulomb", 12.0}}),
       MakeSpec("joint_elasticity", joints, {{"stiffness", 1e4}, {"damping", 1}, {"motor_inertia", 0.1}})});
  Simulator simulator(plant);
  State x = simulator.MakeState(Folded(6), Eigen::VectorXd::Constant(6, 1.0));
  double fastest = 0.0;
  for (int k = 0; k < 100; ++k) {
    const Outcome outcome = simulator.Advance(x, Eigen::VectorXd::Constant(6, 0.2), 0.02);
    ASSERT_TRUE(outcome.ok()) << outcome.ToString();
    fastest = std::max(fastest, x.v.cwiseAbs().maxCoeff());
  }
  EXPECT_LT(fastest, 3.0) << "springs give back what the links brought, no more";
  const Eigen::VectorXd rest = x.q;
  ASSERT_TRUE(simulator.Advance(x, Eigen::VectorXd::Constant(6, 0.2), 5.0).ok());
  EXPECT_LT((x.q - rest).cwiseAbs().maxCoeff(), 5.0 * SimulatorOptions().stick_velocity);
}

// The nominal Mico has neither damping nor rotors: its wrist spins up beyond 100 rad/s.
TEST(Stiffness, AFreelyFallingMicoIsFollowedThroughSpeedsThatOneMillisecondCannotResolve) {
  const Plant plant = MakePlant("mico2");
  Simulator simulator(plant);
  Eigen::VectorXd q(6);
  q << 1.5, 2.5, 2.0, 1.5, 1.5, 1.5;
  State x = simulator.MakeState(q, Eigen::VectorXd::Zero(6));
  double fastest = 0.0;
  for (int k = 0; k < 200; ++k) {
    const Outcome outcome = simulator.Advance(x, Eigen::VectorXd::Constant(6, 0.2 * std::sin(0.3 * k)), 0.04);
    ASSERT_TRUE(outcome.ok()) << outcome.ToString();
    fastest = std::max(fastest, x.v.cwiseAbs().maxCoeff());
  }
  EXPECT_GT(fastest, 100.0);
  EXPECT_LT(fastest, 2000.0);
}

TEST(Sticking, HoldsTheArmUnderGravityWithoutCreep) {
  const auto joints = JointNames(*LoadRobot("mico2"));
  const Plant plant = MakePlant("mico2", {MakeSpec("coulomb_friction", joints, {{"coulomb", 15.0}})});
  Simulator simulator(plant);
  const Eigen::VectorXd q = Folded(6);
  State x = simulator.MakeState(q, Eigen::VectorXd::Zero(6));
  const double seconds = 10.0;
  ASSERT_TRUE(simulator.Advance(x, Eigen::VectorXd::Constant(6, 0.2), seconds).ok());
  // The stated bound: slower than stick_velocity.
  EXPECT_LT((x.q - q).cwiseAbs().maxCoeff(), seconds * SimulatorOptions().stick_velocity);
}

TEST(Sticking, ASlidingBlockStopsWhereCoulombSaysAndStays) {
  const auto joints = JointNames(*LoadRobot("slide"));
  const Plant plant = MakePlant("slide", {MakeSpec("coulomb_friction", joints, {{"coulomb", 80.0}})});
  Simulator simulator(plant);
  Eigen::VectorXd p = plant.parameters().Nominal();
  for (const int i : plant.parameters().OfKind(ParameterKind::kDamping)) p[i] = 0.0;
  simulator.SetParameters(p);
  double mass = 0.0;
  for (const int i : plant.parameters().OfKind(ParameterKind::kMass)) mass += p[i];
  const Eigen::Vector3d q(0.0, 0.0, 0.1), v(0.5, 0.0, 0.0);
  State x = simulator.MakeState(q, v);
  ASSERT_TRUE(simulator.Advance(x, Eigen::VectorXd::Zero(3), 0.5).ok());
  EXPECT_NEAR(x.q[0], 0.5 * 0.5 * 0.5 / (80.0 / mass), 2e-6);  // v²/(2 c/m)
  const double rest = x.q[0];
  ASSERT_TRUE(simulator.Advance(x, Eigen::VectorXd::Zero(3), 1.0).ok());
  EXPECT_NEAR(x.q[0], rest, 1e-6);
}

TEST(Supports, RefusesRk4WithInternalStatesByName) {
  const Plant plant = MakePlant("pendulum", {MakeSpec("actuator_lag", {"hinge"}, {{"time_constant", 0.01}})});
  const Status status = Simulator::Supports(plant, With(Integrator::kRk4, 1e-3));
  EXPECT_FALSE(status.ok());
  EXPECT_NE(status.message().find("lagged_torque.hinge"), std::string::npos) << status.message();
}

}  // namespace
}  // namespace rg::sim
