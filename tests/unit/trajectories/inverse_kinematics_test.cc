#include "services/trajectories/inverse_kinematics.h"

#include <gtest/gtest.h>

#include "common/dynamics/dynamics.h"
#include "tests/unit/trajectories/test_robots.h"

namespace rg::trajectories {
namespace {

model::Pose EndEffector(const model::RobotModel& model, const Eigen::VectorXd& q) {
  dynamics::Mechanism mechanism(model);
  dynamics::Workspace workspace;
  return dynamics::FramePose(mechanism, workspace, q, *model.FindFrame(model.end_effector().name));
}

TEST(InverseKinematics, FindsEveryPositionThatTheArmHasBeenAt) {
  const auto model = LoadRobot("mico2");
  Rng rng(1);
  for (int trial = 0; trial < 40; ++trial) {
    Eigen::VectorXd q = Candle();
    for (int i = 0; i < 6; ++i) q[i] += rng.Uniform(-1.5, 1.5);
    TaskGoal goal{EndEffector(*model, q).translation, std::nullopt, ""};
    const IkResult result = SolveInverseKinematics(*model, goal, Candle(), {}, rng);
    ASSERT_TRUE(result.reached) << "trial " << trial << ": " << result.message;
    EXPECT_LE((EndEffector(*model, result.q).translation - goal.position).norm(), 1e-4);
    EXPECT_TRUE((result.q.array() >= model->LowerLimits().array() + 0.049).all());
    EXPECT_TRUE((result.q.array() <= model->UpperLimits().array() - 0.049).all());
  }
}

TEST(InverseKinematics, MeetsOrientationToo) {
  const auto model = LoadRobot("mico2");
  Rng rng(2);
  int reached = 0;
  for (int trial = 0; trial < 20; ++trial) {
    Eigen::VectorXd q = Candle();
    for (int i = 0; i < 6; ++i) q[i] += rng.Uniform(-1.2, 1.2);
    const model::Pose pose = EndEffector(*model, q);
    const IkResult result =
        SolveInverseKinematics(*model, {pose.translation, pose.rotation, ""}, Candle(), {}, rng);
    if (!result.reached) continue;
    ++reached;
    const model::Pose found = EndEffector(*model, result.q);
    EXPECT_LE((found.translation - pose.translation).norm(), 1e-4);
    EXPECT_LE((found.rotation - pose.rotation).norm(), 3e-3);
  }
  EXPECT_EQ(reached, 20);
}

TEST(InverseKinematics, SaysHowFarAnUnreachableGoalIs) {
  const auto model = LoadRobot("mico2");
  Rng rng(3);
  const IkResult result =
      SolveInverseKinematics(*model, {{2.0, 0.0, 0.3}, std::nullopt, ""}, Candle(), {}, rng);
  EXPECT_FALSE(result.reached);
  EXPECT_GT(result.position_error, 0.5);
  EXPECT_NE(result.message.find("short of (2, 0, 0.3)"), std::string::npos) << result.message;
}

TEST(InverseKinematics, SolvesThePapersGoalAndPrefersTheNearPosture) {
  const auto model = LoadRobot("mico2");
  Rng rng(4);
  const IkResult result =
      SolveInverseKinematics(*model, {{0.40, 0.48, 0.11}, std::nullopt, ""}, Candle(), {}, rng);
  ASSERT_TRUE(result.reached) << result.message;
  EXPECT_GE(result.solutions, 2);
  // From a posture that is a solution already, nothing moves.
  const IkResult again =
      SolveInverseKinematics(*model, {{0.40, 0.48, 0.11}, std::nullopt, ""}, result.q, {}, rng);
  EXPECT_LT((again.q - result.q).norm(), 1e-9);
}

TEST(InverseKinematics, UnknownLinkIsNamed) {
  const auto model = LoadRobot("arm2");
  Rng rng(5);
  const IkResult result = SolveInverseKinematics(*model, {{0.1, 0.0, 0.1}, std::nullopt, "elephant"},
                                                 Eigen::VectorXd::Zero(2), {}, rng);
  EXPECT_FALSE(result.reached);
  EXPECT_EQ(result.message, "the model has no link elephant");
}

}  // namespace
}  // namespace rg::trajectories
