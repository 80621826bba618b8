// A drive that turns with two joints (joint_coupling, form "kinematic"): identities, energy, sticking, and an
// equation of motion written down by hand.
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>

#include "common/dynamics/dynamics.h"
#include "common/sim/export_mjcf.h"
#include "common/sim/export_urdf.h"
#include "common/sim/simulator.h"
#include "tests/support/sim/plants.h"

namespace rg::sim {
namespace {

using effects::EffectSpec;
using effects::MakeSpec;
using Eigen::Vector2d;
using Eigen::VectorXd;
using rg::testing::LoadRobot;
using rg::testing::MakePlant;

struct Drive {
  double ratio = 0, viscous = 0, coulomb = 0, armature = 0;
};

EffectSpec SpecOf(const Drive& d, const std::string& other = "shoulder", const std::string& joint = "elbow") {
  EffectSpec spec = MakeSpec(
      "joint_coupling", {other, joint},
      {{"coefficient", d.ratio}, {"viscous", d.viscous}, {"coulomb", d.coulomb}, {"armature", d.armature}});
  spec.options["form"] = "kinematic";
  return spec;
}

// What the URDF says of damping apart.
PlantOptions Undamped() {
  PlantOptions options;
  for (const char* joint : {"shoulder", "elbow"}) options.nominal[std::string("damping.") + joint] = 0.0;
  return options;
}

Plant Arm(const Drive& d) { return MakePlant("arm2", {SpecOf(d)}, Undamped()); }

std::vector<double> Every(double step, double end) {
  std::vector<double> times;
  for (int k = 0; k * step < end + 1e-9; ++k) times.push_back(k * step);
  return times;
}

CommandSignal Swing(int n, double amplitude, double end) {
  std::vector<double> times = Every(0.01, end);
  Eigen::MatrixXd u(n, static_cast<long>(times.size()));
  for (long k = 0; k < u.cols(); ++k) {
    for (int i = 0; i < n; ++i)
      u(i, k) = amplitude / (1 + i) * std::sin(5.0 * times[static_cast<size_t>(k)] + i);
  }
  return CommandSignal::Create(times, u, Hold::kLinear).value();
}

Trajectory Moved(const Plant& plant, const CommandSignal& command, const std::vector<double>& times,
                 const SimulatorOptions& options = {}, const Vector2d& q = {0.4, 0.7},
                 const Vector2d& v = {0.5, -0.4}) {
  Simulator simulator(plant, options);
  Trajectory out = simulator.Simulate(simulator.MakeState(q, v), command, times);
  EXPECT_TRUE(out.outcome.ok()) << out.outcome.ToString();
  return out;
}

TEST(CoupledDrive, OfRatioZeroIsFrictionAndRotorOfItsOwnJoint) {
  const Plant own = MakePlant("arm2",
                              {MakeSpec("viscous_friction", {"elbow"}, {{"viscous", 0.5}}),
                               MakeSpec("coulomb_friction", {"elbow"}, {{"coulomb", 0.4}}),
                               MakeSpec("rotor_inertia", {"elbow"}, {{"armature", 0.1}})},
                              Undamped());
  const Plant drive = Arm({.ratio = 0, .viscous = 0.5, .coulomb = 0.4, .armature = 0.1});
  const auto times = Every(0.02, 2.0);
  for (const auto integrator : {Integrator::kLeapfrog, Integrator::kSemiImplicitEuler, Integrator::kRk4}) {
    SimulatorOptions options;
    options.integrator = integrator;
    const Trajectory a = Moved(own, Swing(2, 2.0, 2.0), times, options);
    const Trajectory b = Moved(drive, Swing(2, 2.0, 2.0), times, options);
    ASSERT_LT(b.velocity.row(1).minCoeff() * b.velocity.row(1).maxCoeff(), 0) << "it reverses";
    // A joint held for the inertias that others see is held by another number.
    EXPECT_LT((a.position - b.position).cwiseAbs().maxCoeff(), 1e-7);
  }
}

// (M + J R Rᵀ) a = u − c − R d w, by Runge and Kutta in small steps.
TEST(CoupledDrive, MovesAsTheEquationOfMotionWithItsCoordinateSaysItDoes) {
  const Drive d{.ratio = -0.8, .viscous = 0.9, .coulomb = 0, .armature = 0.25};
  const auto model = LoadRobot("arm2");
  const dynamics::Mechanism mechanism(*model);
  dynamics::Workspace workspace;
  const Vector2d R(d.ratio, 1.0), u(1.5, -0.6);
  const auto acceleration = [&](const Vector2d& q, const Vector2d& v) {
    VectorXd bias(2);
    Eigen::MatrixXd M(2, 2);
    dynamics::Rnea(mechanism, workspace, q, v, Vector2d::Zero(), bias);
    dynamics::Crba(mechanism, workspace, q, M);
    M += d.armature * R * R.transpose();
    return Vector2d(M.ldlt().solve(u - bias - d.viscous * R.dot(v) * R));
  };
  Vector2d q(0.4, 0.7), v(0.5, -0.4);
  const double h = 1e-3;
  for (int k = 0; k < 1000; ++k) {
    const Vector2d a1 = acceleration(q, v), v2 = v + 0.5 * h * a1;
    const Vector2d a2 = acceleration(q + 0.5 * h * v, v2), v3 = v + 0.5 * h * a2;
    const Vector2d a3 = acceleration(q + 0.5 * h * v2, v3), v4 = v + h * a3;
    const Vector2d a4 = acceleration(q + h * v3, v4);
    q += h / 6 * (v + 2 * v2 + 2 * v3 + v4);
    v += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4);
  }
  const Plant plant = Arm(d);
  const CommandSignal command = CommandSignal::Constant(u);
  EXPECT_LT((Moved(plant, command, {1.0}, {.integrator = Integrator::kRk4}).position.col(0) - q).norm(),
            1e-9);
  const double coarse = (Moved(plant, command, {1.0}, {.step_s = 4e-3}).position.col(0) - q).norm();
  const double half = (Moved(plant, command, {1.0}, {.step_s = 2e-3}).position.col(0) - q).norm();
  EXPECT_LT(coarse, 1e-4);
  EXPECT_NEAR(coarse / half, 4.0, 0.5) << "of second order";
}

TEST(CoupledDrive, ReversalsOfItsMotorCostNoOrder) {
  const Plant plant = Arm({.ratio = 0.9, .viscous = 0.2, .coulomb = 0.8, .armature = 0.1});
  const auto end = [&](double step) {
    return VectorXd(Moved(plant, Swing(2, 2.0, 2.0), {2.0}, {.step_s = step}).position.col(0));
  };
  EXPECT_LT((end(1e-3) - end(2e-5)).cwiseAbs().maxCoeff(), 2e-5);
}

double Energy(const Drive& d, const VectorXd& q, const VectorXd& v) {
  static const dynamics::Mechanism mechanism(*LoadRobot("arm2"));
  dynamics::Workspace workspace;
  const double w = v[1] + d.ratio * v[0];
  return dynamics::KineticEnergy(mechanism, workspace, q, v) +
         dynamics::PotentialEnergy(mechanism, workspace, q) + 0.5 * d.armature * w * w;
}

TEST(CoupledDrive, LosesItsLevelTimesItsSpeedAndItsViscosityTimesItsSquare) {
  const Drive d{.ratio = 1.3, .viscous = 0.3, .coulomb = 0.25, .armature = 0.2};
  const auto times = Every(1e-3, 3.0);
  const Trajectory out = Moved(Arm(d), CommandSignal::Constant(Vector2d::Zero()), times, {}, {0.9, 1.25});
  double lost = 0, last = 0;
  for (size_t k = 0; k < times.size(); ++k) {
    const auto at = static_cast<long>(k);
    const double w = out.velocity(1, at) + d.ratio * out.velocity(0, at);
    const double power = d.coulomb * std::abs(w) + d.viscous * w * w;
    if (k > 0) lost += 0.5e-3 * (last + power);
    last = power;
    const double energy = Energy(d, out.position.col(at), out.velocity.col(at));
    EXPECT_NEAR(energy + lost, Energy(d, out.position.col(0), out.velocity.col(0)), 2e-3) << times[k];
  }
  EXPECT_GT(lost, 1.0);
}

TEST(CoupledDrive, SticksWithItsJointsMovingAndLosesNothingThen) {
  const Drive d{.ratio = -0.5, .viscous = 2.0, .coulomb = 1e3, .armature = 0.3};
  const auto times = Every(0.01, 2.0);
  const Trajectory out =
      Moved(Arm(d), CommandSignal::Constant(Vector2d::Zero()), times, {}, {0.9, 1.25}, {1.0, 0.5});
  const double start = Energy(d, out.position.col(0), out.velocity.col(0));
  double travel = 0;
  for (long k = 0; k < out.position.cols(); ++k) {
    const double w = out.velocity(1, k) + d.ratio * out.velocity(0, k);
    EXPECT_LT(std::abs(w), SimulatorOptions().stick_velocity);
    const double sum = out.position(1, k) - 1.25 + d.ratio * (out.position(0, k) - 0.9);
    EXPECT_LT(std::abs(sum), 2.0 * SimulatorOptions().stick_velocity)
        << "true sticking: no creep beyond this";
    EXPECT_NEAR(Energy(d, out.position.col(k), out.velocity.col(k)), start, 1e-3);
    travel = std::max(travel, std::abs(out.position(0, k) - 0.9));
  }
  EXPECT_GT(travel, 0.5);
}

// Held until the push on the motor passes its level, which counts all of what reaches it.
TEST(CoupledDrive, BreaksLooseAtItsLevel) {
  const Drive d{.ratio = 0.0, .viscous = 0.1, .coulomb = 2.0, .armature = 0.1};
  // Hanging down, the shoulder held; then the elbow's torque alone is on the motor.
  const EffectSpec held = MakeSpec("coulomb_friction", {"shoulder"}, {{"coulomb", 1e3}});
  const Plant plant = MakePlant("arm2", {SpecOf(d), held}, Undamped());
  for (const double torque : {1.9, 2.1}) {
    const Trajectory out =
        Moved(plant, CommandSignal::Constant(Vector2d(0, torque)), {0.2}, {}, {0, 0}, {0, 0});
    EXPECT_EQ(std::abs(out.position(1, 0)) > 1e-3, torque > 2) << torque;
  }
}

TEST(CoupledDrive, IsTheSameInLanesAsAlone) {
  std::vector<std::string> joints;
  for (int j = 1; j <= 6; ++j) joints.push_back("joint_" + std::to_string(j));
  const Plant plant = MakePlant(
      "mico2",
      {SpecOf({.ratio = 1.0, .viscous = 0.2, .coulomb = 0.3, .armature = 0.05}, "joint_5", "joint_6"),
       MakeSpec("viscous_friction", joints, {{"viscous", 0.3}})});
  Simulator simulator(plant);
  const CommandSignal command = Swing(6, 3.0, 1.0);
  std::vector<std::vector<double>> times;
  std::vector<SimulationWindow> runs;
  SensitivityRequest request{true, {}};
  for (int i = 0; i < plant.parameters().size(); ++i) request.parameters.push_back(i);
  for (int w = 0; w < 9; ++w) times.push_back({0.05 * w, 0.05 * w + 0.0123, 0.05 * w + 0.03});
  for (int w = 0; w < 9; ++w) {
    const VectorXd q = VectorXd::Constant(6, 0.2 + 0.1 * w), v = VectorXd::Constant(6, 0.4 - 0.1 * w);
    runs.push_back({simulator.MakeState(q, v, times[w][0]), &command, &times[w]});
  }
  std::vector<Trajectory> lanes;
  simulator.SimulateWindows(runs, request, &lanes);
  for (int w = 0; w < 9; ++w) {
    const Trajectory alone = simulator.Simulate(runs[w].x0, command, times[w], request);
    ASSERT_TRUE(alone.outcome.ok() && lanes[w].outcome.ok());
    EXPECT_LT((lanes[w].state - alone.state).cwiseAbs().maxCoeff(), 1e-10);
    EXPECT_LT((lanes[w].dposition - alone.dposition).cwiseAbs().maxCoeff(), 1e-8);
  }
}

// Laws of a register (LawPack) and the drive's: a coupled joint behind it, and joints of all kinds beside.
TEST(CoupledDrive, LeavesTheLawsOfOtherJointsAlone) {
  std::vector<std::string> joints;
  for (int j = 1; j <= 6; ++j) joints.push_back("joint_" + std::to_string(j));
  const std::vector<EffectSpec> rest = {MakeSpec("coulomb_friction", joints, {{"coulomb", 0.3}}),
                                        MakeSpec("viscous_friction", joints, {{"viscous", 0.3}}),
                                        MakeSpec("actuator_lag", {"joint_6"}, {{"time_constant", 0.01}})};
  auto with = rest;
  with.push_back(SpecOf({.ratio = 0.7}, "joint_5", "joint_6"));  // which does nothing
  const auto end = [&](const std::vector<EffectSpec>& specs) {
    const Plant plant = MakePlant("mico2", specs);
    Simulator simulator(plant);
    const Trajectory out =
        simulator.Simulate(simulator.MakeState(VectorXd::Constant(6, 0.5), VectorXd::Constant(6, 0.4)),
                           Swing(6, 3.0, 1.0), {1.0});
    EXPECT_TRUE(out.outcome.ok());
    return VectorXd(out.position.col(0));
  };
  EXPECT_LT((end(rest) - end(with)).cwiseAbs().maxCoeff(), 1e-10);
}

TEST(CoupledDrive, IsSaidToBeLeftOutOfExportedModels) {
  const Plant plant = Arm({.ratio = 1.0, .viscous = 0.2, .coulomb = 0.3, .armature = 0.05});
  const VectorXd p = plant.parameters().Nominal();
  const auto urdf = ExportUrdf(plant, p);
  const auto mjcf = ExportMjcf(plant, p);
  ASSERT_TRUE(urdf.ok() && mjcf.ok());
  for (const auto* out : {&*urdf, &*mjcf}) {
    EXPECT_TRUE(std::any_of(out->left_out.begin(), out->left_out.end(), [](const std::string& line) {
      return line.find("joint_coupling (shoulder, elbow)") != std::string::npos;
    }));
  }
}

}  // namespace
}  // namespace rg::sim
