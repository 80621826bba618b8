#include "services/trajectories/mpc_controller.h"

#include <gtest/gtest.h>

#include "tests/unit/trajectories/test_plants.h"

namespace rg::trajectories {
namespace {

std::unique_ptr<MpcController> Make(const sim::Plant& plant, const MpcOptions& options) {
  auto controller = MpcController::Create(plant, plant.parameters().Nominal(), options);
  EXPECT_TRUE(controller.ok()) << controller.status().ToString();
  return std::move(controller).value();
}

TEST(MpcController, DrivesEveryRobotToItsGoalAndStays) {
  for (const char* name : {"pendulum", "arm2", "slide", "arm7"}) {
    SCOPED_TRACE(name);
    const sim::Plant plant = MakePlant(name);
    const int n = plant.num_joints();
    auto controller = Make(plant, {});
    const MotionLimits& limits = controller->limits();
    Eigen::VectorXd q(n), goal(n), u(n);
    for (int i = 0; i < n; ++i) {
      const double low = std::max(limits.position_lower[i], -2.0),
                   high = std::min(limits.position_upper[i], 2.0);
      q[i] = 0.5 * (low + high);
      goal[i] = q[i] + std::min(0.3 * (high - q[i]), 0.5 * limits.velocity[i]);
    }
    sim::Simulator simulator(plant, {.step_s = 0.001});
    sim::State state = simulator.MakeState(q, Eigen::VectorXd::Zero(n));
    for (int k = 0; k < 60; ++k) {
      const MpcStatus status = controller->Solve(state.q, state.v, goal, &u);
      ASSERT_TRUE(status.ok) << k << ": " << status.message;
      EXPECT_TRUE((u.cwiseAbs().array() <= limits.torque.array()).all());
      ASSERT_TRUE(simulator.Advance(state, u, 0.04).ok());
    }
    // Dry friction of the URDF sticks in the simulation and creeps in the plan.
    EXPECT_LT((state.q - goal).lpNorm<Eigen::Infinity>(), 1e-2) << (state.q - goal).transpose();
    EXPECT_LT(state.v.lpNorm<Eigen::Infinity>(), 2e-2);
  }
}

TEST(MpcController, RecoversFromADisturbanceAndANewGoal) {
  const sim::Plant plant = MakePlant("arm2");
  auto controller = Make(plant, {});
  sim::Simulator simulator(plant, {.step_s = 0.001});
  Eigen::VectorXd goal = Eigen::Vector2d(0.3, 0.4), u(2);
  sim::State state = simulator.MakeState(Eigen::Vector2d(0.0, 0.2), Eigen::Vector2d::Zero());
  for (int k = 0; k < 75; ++k) {
    if (k == 10) state.v[1] += 0.3;  // a push
    if (k == 25) goal = Eigen::Vector2d(0.1, 0.7);
    ASSERT_TRUE(controller->Solve(state.q, state.v, goal, &u).ok) << k;
    ASSERT_TRUE(simulator.Advance(state, u, 0.04).ok());
  }
  EXPECT_LT((state.q - goal).lpNorm<Eigen::Infinity>(), 5e-3);
}

TEST(MpcController, FindsTheTorqueThatItsModelMissesInTheNextVelocity) {
  const sim::Plant plant = MakePlant("arm2");
  auto controller = Make(plant, {});
  sim::Simulator simulator(plant, {.step_s = 0.001});
  const Eigen::VectorXd goal = Eigen::Vector2d(0.3, 0.4), missed = Eigen::Vector2d(-0.4, 0.3);
  EXPECT_EQ(controller->TorqueToReach(Eigen::Vector2d(1, 1)), Eigen::Vector2d::Zero()) << "no plan yet";
  Eigen::VectorXd u(2);
  sim::State state = simulator.MakeState(Eigen::Vector2d(0.0, 0.2), Eigen::Vector2d::Zero());
  for (int k = 0; k < 20; ++k) {
    ASSERT_TRUE(controller->Solve(state.q, state.v, goal, &u).ok) << k;
    ASSERT_TRUE(simulator.Advance(state, u + missed, 0.04).ok());
    EXPECT_LT((controller->TorqueToReach(state.v) - missed).norm(), 0.02) << k;
  }
}

TEST(MpcController, NotANumberIsRefusedWithASafeTorque) {
  const sim::Plant plant = MakePlant("arm2");
  auto controller = Make(plant, {});
  Eigen::VectorXd u;
  const Eigen::VectorXd goal = Eigen::Vector2d(0.3, 0.4);
  ASSERT_TRUE(controller->Solve(Eigen::Vector2d(0.0, 0.2), Eigen::Vector2d::Zero(), goal, &u).ok);
  Eigen::Vector2d bad(std::numeric_limits<double>::quiet_NaN(), 0.0);
  const MpcStatus status = controller->Solve(bad, Eigen::Vector2d::Zero(), goal, &u);
  EXPECT_FALSE(status.ok);
  EXPECT_FALSE(status.message.empty());
  EXPECT_TRUE(u.allFinite());
  // And it is itself again afterwards.
  EXPECT_TRUE(controller->Solve(Eigen::Vector2d(0.0, 0.2), Eigen::Vector2d::Zero(), goal, &u).ok);
}

TEST(MpcController, RefusesOptionsByName) {
  const sim::Plant plant = MakePlant("arm2");
  auto refused = [&](const MpcOptions& options, const std::string& part) {
    const auto made = MpcController::Create(plant, plant.parameters().Nominal(), options);
    ASSERT_FALSE(made.ok()) << part;
    EXPECT_NE(made.status().message().find(part), std::string::npos) << made.status().message();
  };
  MpcOptions options;
  options.interval_s = 0.0;
  refused(options, "interval_s");
  options = {};
  options.peak_torque = Eigen::VectorXd::Ones(3);
  refused(options, "peak_torque");
  options = {};
  options.time_budget_s = 0.02;
  refused(options, "clock");
  EXPECT_FALSE(MpcController::Create(plant, Eigen::VectorXd::Zero(1), {}).ok());
}

TEST(MpcController, PlansWithInternalStatesOfEffects) {
  const sim::Plant plant = MakePlant(
      "arm2", {effects::MakeSpec("actuator_lag", {"shoulder", "elbow"}, {{"time_constant", 0.05}})});
  ASSERT_EQ(plant.num_internal_states(), 2);
  auto controller = Make(plant, {});
  sim::Simulator simulator(plant, {.step_s = 0.001});
  const Eigen::VectorXd goal = Eigen::Vector2d(0.4, 0.5);
  Eigen::VectorXd u(2);
  sim::State state = simulator.MakeState(Eigen::Vector2d(0.0, 0.2), Eigen::Vector2d::Zero());
  for (int k = 0; k < 60; ++k) {
    ASSERT_TRUE(controller->Solve(state.q, state.v, goal, &u).ok) << k;
    ASSERT_TRUE(simulator.Advance(state, u, 0.04).ok());
  }
  EXPECT_LT((state.q - goal).lpNorm<Eigen::Infinity>(), 5e-3);
}

}  // namespace
}  // namespace rg::trajectories
