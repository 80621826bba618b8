#include "robot_agent/rollout/controllers.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "common/sim/simulator.h"
#include "robot_agent/rollout/limited_controller.h"
#include "tests/unit/robot_agent/allocation_counter.h"
#include "tests/unit/trajectories/test_robots.h"

namespace rg::robot_agent {
namespace {

using testing::HasSubstr;

// One joint: tau = 2 - 3 (q - goal) by one layer without hidden ones.
policy::Policy Linear() {
  policy::Policy::Parts parts;
  parts.joints = {"a"};
  parts.encoding.inputs = 3;
  parts.input_mean = {0, 0, 0};
  parts.input_scale = {1, 1, 1};
  parts.output_mean = {2};
  parts.output_scale = {1};
  parts.network = policy::Network({3, 1});
  auto& weights = parts.network.parameters();
  weights[parts.network.WeightIndex(0, 0, 0)] = -3.0f;
  weights[parts.network.WeightIndex(0, 0, 2)] = 3.0f;
  return policy::Policy(parts);
}

TEST(PolicyControllers, FeedStateAndGoalAndAllocateNothing) {
  const auto controller =
      PolicyController::Create(Linear(), {"a"}, Eigen::VectorXd::Constant(1, 0.5)).value();
  const double q = 1.0, v = 0.0;
  double tau = 0.0;
  const long before = AllocationsOfThisThread();
  controller->Command(0, &q, &v, &tau);
  EXPECT_EQ(AllocationsOfThisThread(), before);
  EXPECT_NEAR(tau, 0.5, 1e-6);
}

TEST(PolicyControllers, ToldToApproachTheirGoalTheySeeItMoveThereEvenly) {
  const auto controller =
      PolicyController::Create(Linear(), {"a"}, Eigen::VectorXd::Constant(1, 0.5)).value();
  controller->ApproachGoal(Eigen::VectorXd::Constant(1, 0.1), 2.0);
  const double q = 0.0, v = 0.0;
  for (const auto& [t, goal] : {std::pair{0.0, 0.1}, {1.0, 0.3}, {2.0, 0.5}, {3.0, 0.5}}) {
    double tau = 0.0;
    controller->Command(t, &q, &v, &tau);
    EXPECT_NEAR(tau, 2.0 + 3.0 * goal, 1e-6) << t;
  }
}

TEST(PolicyControllers, AStateThatIsNotFiniteGivesNanNotTheLastTorque) {
  const auto controller =
      PolicyController::Create(Linear(), {"a"}, Eigen::VectorXd::Constant(1, 0.5)).value();
  const double q = std::numeric_limits<double>::quiet_NaN(), v = 0.0;
  double tau = 1.0;
  controller->Command(0, &q, &v, &tau);
  EXPECT_TRUE(std::isnan(tau));
}

TEST(PolicyControllers, OtherRobotsPoliciesAreRefused) {
  EXPECT_THAT(PolicyController::Create(Linear(), {"b"}, Eigen::VectorXd::Zero(1)).status().message(),
              HasSubstr("other joints"));
  EXPECT_THAT(PolicyController::Create(Linear(), {"a", "b"}, Eigen::VectorXd::Zero(2)).status().message(),
              HasSubstr("3 inputs"));
}

TEST(TrajectoryControllers, HoldEachRowAndCorrectWithGains) {
  TrajectoryController::Plan plan;
  plan.t = Eigen::Vector3d(0, 0.1, 0.2);
  plan.tau = Eigen::RowVector3d(1, 2, 3);
  const double q = 0.1, v = -1.0;
  double tau = 0;
  const auto open_loop = TrajectoryController::Create(plan).value();
  for (const auto& [t, expected] : {std::pair(-0.1, 1.0), {0.05, 1.0}, {0.1, 2.0}, {0.19, 2.0}, {9.0, 3.0}}) {
    open_loop->Command(t, &q, &v, &tau);
    EXPECT_EQ(tau, expected) << t;
  }
  plan.q = plan.v = Eigen::RowVector3d::Zero();
  plan.gain_q = Eigen::VectorXd::Constant(1, 10);
  plan.gain_v = Eigen::VectorXd::Constant(1, 2);
  TrajectoryController::Create(plan).value()->Command(0, &q, &v, &tau);
  EXPECT_NEAR(tau, 1 - 1 + 2, 1e-12);
  plan.t[2] = 0.1;
  EXPECT_THAT(TrajectoryController::Create(plan).status().message(), HasSubstr("row 2"));
}

struct Weightless final : ArmModel {
  void GravityTorque(const double*, double* tau) override { tau[0] = 0.0; }
  void Tip(const double*, double* position) override { position[0] = position[1] = position[2] = 0.0; }
};

// A joint of 1 kg·m² under 5 N·m, 25 Hz.
double SpeedAfterASecond(Controller& controller, double start) {
  double q = 0.0, v = start, fastest = std::abs(start);
  for (int k = 0; k < 25; ++k) {
    double tau = 0.0;
    controller.Command(0.04 * k, &q, &v, &tau);
    q += 0.04 * v, v += 0.04 * tau;
    fastest = std::max(fastest, std::abs(v));
  }
  return fastest;
}

// What the first rollout of a loop meets: dry friction that the belief lacks, and more of it than the plan asks for.
TEST(MpcControllers, ReachTheirGoalThroughFrictionThatTheBeliefLacks) {
  const auto arm = [](std::vector<effects::EffectSpec> effects) {
    return sim::Plant::Create(trajectories::LoadRobot("arm2"), {}, std::move(effects)).value();
  };
  const sim::Plant belief = arm({});
  const sim::Plant robot =
      arm({effects::MakeSpec("coulomb_friction", {"shoulder", "elbow"}, {{"coulomb", 1.0}})});
  const Eigen::VectorXd goal = Eigen::Vector2d(0.3, 0.4), values = belief.parameters().Nominal();
  const auto controller =
      MakeMpcController(belief, values, goal, belief.model().EffortLimits(), 25.0).value();
  sim::Simulator simulator(robot, {.step_s = 0.001});
  sim::State state = simulator.MakeState(Eigen::Vector2d(0.0, 0.2), Eigen::Vector2d::Zero());
  Eigen::VectorXd tau(2);
  for (int k = 0; k < 150; ++k) {
    controller->Command(0.04 * k, state.q.data(), state.v.data(), tau.data());
    ASSERT_TRUE(simulator.Advance(state, tau, 0.04).ok());
  }
  EXPECT_LT((state.q - goal).lpNorm<Eigen::Infinity>(), 0.02) << state.q.transpose();
}

TEST(LimitedControllers, KeepAJointThatSpeedsUpWithinItsLimitAndAllocateNothing) {
  Weightless arm;
  FunctionController pushes([](double, const double*, const double*, double* tau) { tau[0] = 5.0; });
  LimitedController limited(pushes, arm, {.velocity = Eigen::VectorXd::Constant(1, 1.0)});
  EXPECT_GT(SpeedAfterASecond(pushes, 0.0), 4.0);
  EXPECT_LE(SpeedAfterASecond(limited, 0.0), 1.0);
  EXPECT_GT(limited.limited(), 0);
  double q = 0.0, v = 0.9, tau = 0.0;
  const long before = AllocationsOfThisThread();
  limited.Command(2.0, &q, &v, &tau);
  EXPECT_EQ(AllocationsOfThisThread(), before);
  EXPECT_EQ(tau, 0.0) << "beyond its share nothing drives it on";
}

TEST(LimitedControllers, LetATorqueThatBrakesAndASlowJointAlone) {
  Weightless arm;
  FunctionController pushes([](double, const double*, const double*, double* tau) { tau[0] = 5.0; });
  LimitedController limited(pushes, arm, {.velocity = Eigen::VectorXd::Constant(1, 1.0)});
  double q = 0.0, v = -0.95, tau = 0.0;
  limited.Command(0.0, &q, &v, &tau);
  EXPECT_EQ(tau, 5.0);
  EXPECT_EQ(limited.limited(), 0);
  LimitedController fresh(pushes, arm, {.velocity = Eigen::VectorXd::Constant(1, 1.0)});
  v = 0.3;
  fresh.Command(0.0, &q, &v, &tau);
  EXPECT_EQ(tau, 5.0);
}

TEST(Excitation, StaysWithinItsAmplitudeMovesEveryJointAndIsOverBeforeTheEnd) {
  FunctionController nothing(
      [](double, const double*, const double*, double* tau) { tau[0] = tau[1] = 1.0; });
  ExcitedController excited(nothing, Eigen::Vector2d(0.5, 0.1), 6.0, 3);
  ExcitedController same(nothing, Eigen::Vector2d(0.5, 0.1), 6.0, 3);
  const double zero[2] = {0, 0};
  double peak[2] = {0, 0};
  for (int k = 0; k <= 150; ++k) {
    double tau[2], again[2];
    excited.Command(0.04 * k, zero, zero, tau);
    same.Command(0.04 * k, zero, zero, again);
    for (int i = 0; i < 2; ++i) {
      EXPECT_EQ(tau[i], again[i]);
      peak[i] = std::max(peak[i], std::abs(tau[i] - 1.0));
      EXPECT_TRUE(0.04 * k < 4.2 || tau[i] == 1.0) << k;
    }
  }
  EXPECT_LE(peak[0], 0.5);
  EXPECT_LE(peak[1], 0.1);
  EXPECT_GT(peak[0], 0.2);
  EXPECT_GT(peak[1], 0.04);
}

}  // namespace
}  // namespace rg::robot_agent
