#include "services/trajectories/plant_problem.h"

#include <gtest/gtest.h>

#include "common/base/rng.h"
#include "common/dynamics/dynamics.h"
#include "tests/unit/trajectories/test_plants.h"

namespace rg::trajectories {
namespace {

TEST(HoldTorque, IsTheGravityTorqueOfARigidPlant) {
  const sim::Plant plant = MakePlant("mico2");
  sim::Simulator simulator(plant);
  Eigen::VectorXd q = Candle(), u, gravity(6);
  q[1] -= 0.8;
  q[2] += 0.5;
  EXPECT_LT(HoldTorque(simulator, q, &u), 1e-6);
  dynamics::Mechanism mechanism(plant.model());
  dynamics::Workspace workspace;
  dynamics::GravityTorque(mechanism, workspace, q, gravity);
  EXPECT_LT((u - gravity).lpNorm<Eigen::Infinity>(), 1e-8);
  EXPECT_GT(gravity.lpNorm<Eigen::Infinity>(), 1.0);
}

TEST(HoldTorque, AccountsForEffects) {
  const sim::Plant plant = MakePlant("mico2", {effects::MakeSpec("payload", {}, {{"mass", 0.5}})});
  sim::Simulator simulator(plant);
  Eigen::VectorXd q = Candle(), u;
  q[1] -= 0.8;
  EXPECT_LT(HoldTorque(simulator, q, &u), 1e-6);
  sim::State state = simulator.MakeState(q, Eigen::VectorXd::Zero(6));
  ASSERT_TRUE(simulator.Advance(state, u, 0.5).ok());
  EXPECT_LT((state.q - q).lpNorm<Eigen::Infinity>(), 1e-6);
}

TEST(PlantProblem, LinearisationMatchesCentralDifferences) {
  const sim::Plant plant = MakePlant("mico2", {effects::MakeSpec("viscous_friction", {"joint_6"}, {})});
  sim::Simulator simulator(plant, {.step_s = 0.005});
  const MotionLimits limits = MotionLimits::FromModel(plant.model());
  PlantProblem problem(simulator, 3, 0.04, limits, TrackingWeights::ForBandwidth(8.0, limits.torque));
  const int nx = problem.nx();
  Rng rng(3);
  Eigen::VectorXd x = Eigen::VectorXd::Zero(nx), u(6), next(nx), plus(nx), minus(nx);
  x.head(6) = Candle();
  for (int i = 0; i < 6; ++i) {
    x[i] += rng.Uniform(-0.5, 0.5);
    x[6 + i] = rng.Uniform(-0.5, 0.5);
    u[i] = rng.Uniform(-0.02, 0.02);
  }
  Eigen::VectorXd hold;
  HoldTorque(simulator, x.head(6), &hold);
  u += hold;
  Eigen::MatrixXd A(nx, nx), B(nx, 6);
  ASSERT_TRUE(problem.StepLinearized(0, x, u, next, A, B));
  const double h = 1e-6;
  for (int j = 0; j < nx + 6; ++j) {
    Eigen::VectorXd x_plus = x, x_minus = x, u_plus = u, u_minus = u;
    if (j < nx)
      x_plus[j] += h, x_minus[j] -= h;
    else
      u_plus[j - nx] += h, u_minus[j - nx] -= h;
    ASSERT_TRUE(problem.Step(0, x_plus, u_plus, plus));
    ASSERT_TRUE(problem.Step(0, x_minus, u_minus, minus));
    const Eigen::VectorXd column = j < nx ? A.col(j).eval() : B.col(j - nx).eval();
    EXPECT_LT(((plus - minus) / (2 * h) - column).lpNorm<Eigen::Infinity>(), 1e-4 * (1.0 + column.norm()))
        << j;
  }
}

TEST(PlanningModel, DropsPureDelaysOnly) {
  const sim::Plant plant =
      MakePlant("arm2", {effects::MakeSpec("actuator_delay", {"shoulder", "elbow"}, {{"delay", 0.03}})});
  EXPECT_TRUE(MakePlanningModel(plant, plant.parameters().Nominal()).plant.effects().empty());
}

TEST(PlanningModel, CarriesTheMotorBehindAPlayWithTheLink) {
  const sim::Plant plant = MakePlant(
      "arm2", {effects::MakeSpec("backlash", {"elbow"}, {{"motor_inertia", 0.2}, {"motor_viscous", 0.4}}),
               effects::MakeSpec("rotor_inertia", {"elbow"}, {{"armature", 0.1}}),
               effects::MakeSpec("encoder_offset", {"elbow"}, {{"offset", 0.05}})});
  const PlanningModel model = MakePlanningModel(plant, plant.parameters().Nominal());
  const auto value = [&](const char* name) { return model.values[model.plant.parameters().Find(name)]; };
  EXPECT_NEAR(value("rotor_inertia.elbow.armature"), 0.3, 1e-12);
  EXPECT_NEAR(value("viscous_friction.elbow.viscous"), 0.4, 1e-12);
  EXPECT_EQ(model.plant.num_internal_states(), 0);
  EXPECT_EQ(model.encoder_offset, Eigen::Vector2d(0.0, 0.05));
}

TEST(MotionLimits, PeakTorquesOfTheMicoCapTheUrdf) {
  const auto model = LoadRobot("mico2");
  const MotionLimits limits = MotionLimits::FromModel(*model, KnownPeakTorques(*model));
  EXPECT_EQ(limits.torque[1], 30.5);
  EXPECT_EQ(limits.torque[5], 6.8);
  EXPECT_EQ(MotionLimits::FromModel(*model).torque[1], 80.0);
  EXPECT_EQ(KnownPeakTorques(*LoadRobot("arm2")).size(), 0);
}

}  // namespace
}  // namespace rg::trajectories
