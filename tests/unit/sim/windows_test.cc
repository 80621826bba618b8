// Windows side by side in SIMD lanes against the same windows one by one, on every instruction set.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "common/base/rng.h"
#include "common/math/isa.h"
#include "common/sim/simulator.h"
#include "tests/support/sim/plants.h"

namespace rg::sim {
namespace {

using effects::MakeSpec;
using rg::testing::JointNames;
using rg::testing::LoadRobot;
using rg::testing::MakePlant;

// Windows of different lengths, rates, starts and commands.
struct Windows {
  Windows(const Plant& plant, const Simulator& simulator, int count, uint64_t seed) {
    Rng rng(seed);
    const int n = plant.num_joints();
    commands.reserve(count);
    times.resize(count);
    for (int w = 0; w < count; ++w) {
      const double start = 0.37 * w;
      std::vector<double> knots;
      Eigen::MatrixXd u(n, 30);
      for (int k = 0; k < 30; ++k) {
        knots.push_back(start - 0.1 + 0.0213 * k);
        for (int i = 0; i < n; ++i) u(i, k) = 1.2 / (1 + i) * std::sin(0.9 * k + i + w);
      }
      commands.push_back(
          CommandSignal::Create(knots, u, w % 2 == 0 ? Hold::kZeroOrder : Hold::kLinear).value());
      double t = start + (w % 3 == 0 ? 0.0 : 0.0043);
      for (int k = 0; k < 3 + 5 * (w % 4); ++k, t += w % 5 == 0 ? 0.0107 : 0.0061) times[w].push_back(t);
      Eigen::VectorXd q(n), v(n);
      for (int i = 0; i < n; ++i) q[i] = rng.Uniform(0.4, 2.0), v[i] = rng.Uniform(-0.6, 0.6);
      runs.push_back({simulator.MakeState(q, v, start, commands.back()), &commands.back(), &times[w]});
    }
  }
  std::vector<CommandSignal> commands;
  std::vector<std::vector<double>> times;
  std::vector<SimulationWindow> runs;
};

double Difference(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b) {
  if (a.rows() != b.rows() || a.cols() != b.cols()) return std::numeric_limits<double>::infinity();
  if (a.size() == 0) return 0.0;
  return (a - b).cwiseAbs().maxCoeff() / (1.0 + b.cwiseAbs().maxCoeff());
}

void ExpectSame(const Trajectory& lanes, const Trajectory& alone, double tolerance, int window) {
  EXPECT_EQ(lanes.outcome.ok(), alone.outcome.ok()) << window;
  EXPECT_EQ(lanes.reached, alone.reached) << window;
  EXPECT_EQ(lanes.times, alone.times) << window;
  EXPECT_LT(Difference(lanes.position, alone.position), tolerance) << window;
  EXPECT_LT(Difference(lanes.velocity, alone.velocity), tolerance) << window;
  EXPECT_LT(Difference(lanes.state, alone.state), tolerance) << window;
  EXPECT_LT(Difference(lanes.dposition, alone.dposition), tolerance) << window;
  EXPECT_LT(Difference(lanes.dvelocity, alone.dvelocity), tolerance) << window;
  EXPECT_LT(Difference(lanes.dfinal_state, alone.dfinal_state), tolerance) << window;
}

// The same, but outputs' sensitivities only where the last one is.
void ExpectSameAtEnd(const Trajectory& at_end, const Trajectory& all, int n, int window) {
  EXPECT_EQ(Difference(at_end.position, all.position), 0.0) << window;
  EXPECT_EQ(Difference(at_end.velocity, all.velocity), 0.0) << window;
  ASSERT_EQ(at_end.dposition.rows(), n) << window;
  EXPECT_EQ(Difference(at_end.dposition, all.dposition.bottomRows(n)), 0.0) << window;
  EXPECT_EQ(Difference(at_end.dvelocity, all.dvelocity.bottomRows(n)), 0.0) << window;
  EXPECT_EQ(Difference(at_end.dfinal_state, all.dfinal_state), 0.0) << window;
}

SensitivityRequest Everything(const Plant& plant) {
  SensitivityRequest request{.initial_state = true, .parameters = {}};
  for (int i = 0; i < plant.parameters().size(); ++i) request.parameters.push_back(i);
  return request;
}

std::vector<math::Isa> SupportedIsas() {
  std::vector<math::Isa> out;
  for (const math::Isa isa : {math::Isa::kV1, math::Isa::kV3, math::Isa::kV4}) {
    if (math::IsaSupported(isa)) out.push_back(isa);
  }
  return out;
}

// Lanes against windows one by one on one instruction set, which run on `reference` too.
void CompareOn(math::Isa isa, const Plant& plant, Integrator integrator, std::vector<Trajectory>* reference) {
  Simulator simulator(plant, {.integrator = integrator, .isa = isa});
  Eigen::VectorXd p = plant.parameters().Nominal();
  for (const std::string& joint : plant.joint_names()) p[plant.parameters().Find("damping." + joint)] = 0.5;
  simulator.SetParameters(p);
  const Windows windows(plant, simulator, 13, 5);
  const SensitivityRequest request = Everything(plant);
  std::vector<Trajectory> lanes, values, at_end;
  simulator.SimulateWindows(windows.runs, request, &lanes);
  simulator.SimulateWindows(windows.runs, {}, &values);
  std::vector<SimulationWindow> runs = windows.runs;
  for (SimulationWindow& run : runs) run.derivatives_at_end = true;
  simulator.SimulateWindows(runs, request, &at_end);
  ASSERT_EQ(lanes.size(), windows.runs.size());
  for (size_t w = 0; w < windows.runs.size(); ++w) {
    const auto& run = windows.runs[w];
    const Trajectory alone = simulator.Simulate(run.x0, *run.command, *run.times, request);
    EXPECT_TRUE(alone.outcome.ok()) << alone.outcome.ToString();
    ExpectSame(lanes[w], alone, 2e-12, static_cast<int>(w));
    EXPECT_EQ(Difference(values[w].position, lanes[w].position), 0.0) << w;
    EXPECT_EQ(values[w].dposition.size(), 0);
    ExpectSameAtEnd(at_end[w], lanes[w], plant.num_joints(), static_cast<int>(w));
    if (reference->size() <= w) reference->push_back(alone);
    ExpectSame(lanes[w], (*reference)[w], 1e-9, static_cast<int>(w));
  }
}

void Compare(const std::string& robot, std::vector<effects::EffectSpec> effects,
             Integrator integrator = Integrator::kLeapfrog) {
  const Plant plant = MakePlant(robot, std::move(effects));
  std::vector<Trajectory> plain;
  for (const math::Isa isa : SupportedIsas()) {
    SCOPED_TRACE(robot + " on " + math::IsaName(isa));
    CompareOn(isa, plant, integrator, &plain);
  }
}

TEST(SimulateWindows, IsSimulateForRigidRobots) {
  Compare("pendulum", {});
  Compare("arm2", {});
  Compare("mico2", {});
  Compare("arm2", {}, Integrator::kSemiImplicitEuler);
  Compare("mico2", {}, Integrator::kSemiImplicitEuler);
}

TEST(SimulateWindows, IsSimulateWithFrictionElasticityLagAndDelay) {
  for (const char* robot : {"pendulum", "arm2", "mico2"}) {
    const auto joints = JointNames(*LoadRobot(robot));
    Compare(robot, {MakeSpec("coulomb_friction", joints, {{"coulomb", 0.3}}),
                    MakeSpec("rotor_inertia", joints, {{"armature", 0.02}}),
                    MakeSpec("joint_elasticity", joints,
                             {{"stiffness", 1e4}, {"damping", 2}, {"motor_inertia", 0.05}}),
                    MakeSpec("actuator_lag", joints, {{"time_constant", 0.01}}),
                    MakeSpec("actuator_delay", joints, {{"delay", 0.0053}})});
  }
}

// Delays below a step, of some steps, and beyond the first outputs, which look back before the start.
TEST(SimulateWindows, IsSimulateWithLateSensors) {
  for (const char* robot : {"pendulum", "arm2", "mico2"}) {
    const auto joints = JointNames(*LoadRobot(robot));
    for (const double delay : {0.0011, 0.0083, 0.031}) {
      SCOPED_TRACE(delay);
      Compare(robot, {MakeSpec("sensor_delay", joints, {{"delay", delay}})});
      auto speeds = MakeSpec("sensor_delay", {joints[0]}, {{"delay", delay}});
      speeds.options["signal"] = "velocity";
      auto positions = MakeSpec("sensor_delay", {joints.back()}, {{"delay", 0.6 * delay}});
      positions.options["signal"] = "position";
      std::vector<effects::EffectSpec> some = {speeds,
                                               MakeSpec("viscous_friction", joints, {{"viscous", 0.3}})};
      if (joints.size() > 1) some.push_back(positions);
      Compare(robot, some);
      auto motor = MakeSpec("joint_elasticity", {joints[0]},
                            {{"stiffness", 1e4}, {"damping", 2}, {"motor_inertia", 0.05}});
      motor.options["sensor"] = "motor";
      Compare(robot,
              {motor, MakeSpec("sensor_delay", joints, {{"delay", delay}}),
               MakeSpec("actuator_delay", joints, {{"delay", 0.0053}})},
              Integrator::kSemiImplicitEuler);
    }
  }
}

TEST(SimulateWindows, IsSimulateWhereJointsHaveDifferentLaws) {
  const auto joints = JointNames(*LoadRobot("mico2"));
  Compare("mico2", {MakeSpec("stribeck_friction", {joints[1], joints[4]},
                             {{"coulomb", 0.2}, {"static", 0.4}, {"stribeck_velocity", 0.05}}),
                    MakeSpec("backlash", {joints[0]}, {{"gap", 0.01}}),
                    MakeSpec("presliding_hysteresis", {joints[5]}, {{"coulomb", 0.1}}),
                    MakeSpec("torque_ripple", {joints[2]}, {{"amplitude", 0.2}}),
                    MakeSpec("thermal_drift", {joints[3]}, {{"initial", 0.3}, {"final", 0.1}}),
                    MakeSpec("joint_coupling", {joints[3], joints[4]}, {{"coefficient", 0.1}}),
                    MakeSpec("external_disturbance", {}, {{"start", 0.1}, {"end", 0.9}, {"force_x", 1.0}})});
}

// A few gates and loops decide by lane: one window must not see what the others do.
void ExpectSameBitsInWhateverCompany(const Plant& plant, math::Isa isa) {
  Simulator simulator(plant, {.isa = isa});
  const Windows windows(plant, simulator, 11, 9);
  const SensitivityRequest request = Everything(plant);
  std::vector<Trajectory> together, reversed, alone;
  simulator.SimulateWindows(windows.runs, request, &together);
  simulator.SimulateWindows({windows.runs.rbegin(), windows.runs.rend()}, request, &reversed);
  for (size_t w = 0; w < windows.runs.size(); ++w) {
    simulator.SimulateWindows({windows.runs[w]}, request, &alone);
    const Trajectory& other = reversed[windows.runs.size() - 1 - w];
    EXPECT_EQ(together[w].state, other.state) << w;
    EXPECT_EQ(together[w].dposition, other.dposition) << w;
    EXPECT_EQ(together[w].state, alone[0].state) << w;
    EXPECT_EQ(together[w].dvelocity, alone[0].dvelocity) << w;
  }
}

TEST(SimulateWindows, GiveTheSameBitsInWhateverCompany) {
  for (const char* robot : {"arm2", "mico2"}) {
    const auto joints = JointNames(*LoadRobot(robot));
    const Plant plant = MakePlant(robot, {MakeSpec("coulomb_friction", joints, {{"coulomb", 0.5}})});
    for (const math::Isa isa : SupportedIsas()) ExpectSameBitsInWhateverCompany(plant, isa);
  }
}

TEST(SimulateWindows, KeepAFailureToItsOwnWindow) {
  const Plant plant = MakePlant("arm2");
  Simulator simulator(plant);
  Windows windows(plant, simulator, 9, 3);
  const SensitivityRequest request = Everything(plant);
  std::vector<Trajectory> good, mixed;
  simulator.SimulateWindows(windows.runs, request, &good);
  windows.runs[2].x0.v[0] = std::numeric_limits<double>::quiet_NaN();
  windows.runs[5].x0.v[1] = 1e200;
  simulator.SimulateWindows(windows.runs, request, &mixed);
  for (size_t w = 0; w < windows.runs.size(); ++w) {
    if (w == 2 || w == 5) {
      const auto& run = windows.runs[w];
      const Trajectory alone = simulator.Simulate(run.x0, *run.command, *run.times, request);
      EXPECT_FALSE(mixed[w].outcome.ok());
      EXPECT_EQ(mixed[w].outcome.ToString(), alone.outcome.ToString());
      EXPECT_EQ(mixed[w].reached, alone.reached);
    } else {
      EXPECT_EQ(mixed[w].state, good[w].state) << w;
      EXPECT_EQ(mixed[w].dposition, good[w].dposition) << w;
    }
  }
}

TEST(SimulateWindows, RunSideBySideWithLateSensorsAndNotByRk4) {
  const auto joints = JointNames(*LoadRobot("arm2"));
  const Plant plant = MakePlant("arm2", {MakeSpec("sensor_delay", joints, {{"delay", 0.004}})});
  EXPECT_EQ(Simulator(plant, {.integrator = Integrator::kRk4}).lanes(), 1);
  EXPECT_EQ(Simulator(plant).lanes(), Simulator(MakePlant("arm2")).lanes());
  EXPECT_GE(Simulator(plant).lanes(), 2);
}

}  // namespace
}  // namespace rg::sim
