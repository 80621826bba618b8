#include "services/rollouts/rollout_spec.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>

#include "common/model/urdf_loader.h"

namespace rg::rollouts {
namespace {

using testing::HasSubstr;

model::RobotModel Mico() {
  const std::string root = std::getenv("RG_SOURCE_DIR");
  return model::LoadUrdf(root + "/deploy/robots/mico2.urdf",
                         {.joints = {"joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6"},
                          .locked = {},
                          .end_effector = ""})
      .value();
}

TEST(RolloutSpecs, RefusalsNameTheFieldAndItsValue) {
  RolloutSpec spec;
  spec.id = "../x";
  EXPECT_THAT(CheckSpec(spec).message(), HasSubstr("id \"../x\""));
  spec.id = "x";
  spec.rate_hz = 0;
  EXPECT_THAT(CheckSpec(spec).message(), HasSubstr("rate_hz is 0"));
}

TEST(GoalSampling, GoalsAreWithinReachOfTimeAndInsideTheBoxAndNeverTheStart) {
  const model::RobotModel model = Mico();
  Eigen::VectorXd start(6);
  start << 0, 3.14159, 3.14159, 0, 0, 0;
  const Eigen::VectorXd lower = start.array() - 0.4, upper = start.array() + 0.4;
  const Eigen::VectorXd reach = 0.6 * model.VelocityLimits() * 0.8;
  for (uint64_t seed = 0; seed < 300; ++seed) {
    Rng rng(seed);
    const Eigen::VectorXd goal = SampleGoal(model, start, lower, upper, 0.8, rng);
    const Eigen::VectorXd way = (goal - start).cwiseAbs();
    EXPECT_TRUE((way.array() <= reach.array()).all());
    EXPECT_TRUE((way.array() <= 0.35 + 1e-12).all());
    EXPECT_GE((way.array() / reach.array()).maxCoeff(), 0.5);
  }
}

TEST(GoalSampling, SameSeedSameGoal) {
  const model::RobotModel model = Mico();
  const Eigen::VectorXd start = Eigen::VectorXd::Constant(6, 2.0);
  const Eigen::VectorXd lower = start.array() - 1, upper = start.array() + 1;
  Rng a(5), b(5), c(6);
  const Eigen::VectorXd goal = SampleGoal(model, start, lower, upper, 1, a);
  EXPECT_EQ(goal, SampleGoal(model, start, lower, upper, 1, b));
  EXPECT_NE(goal, SampleGoal(model, start, lower, upper, 1, c));
}

}  // namespace
}  // namespace rg::rollouts
