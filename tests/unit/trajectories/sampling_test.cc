#include "services/trajectories/sampling.h"

#include <gtest/gtest.h>

#include "tests/unit/trajectories/test_robots.h"

namespace rg::trajectories {
namespace {

TEST(StartGoalSampler, KeepsLimitsReachAndTheSameDistributionForBothEnds) {
  const auto model = LoadRobot("mico2");
  const MotionLimits limits = MotionLimits::FromModel(*model);
  SamplingOptions options;
  options.home = Candle();
  auto sampler = StartGoalSampler::Create(*model, limits, 1.0, options);
  ASSERT_TRUE(sampler.ok()) << sampler.status().ToString();
  Rng rng(1);
  const int count = 4000;
  Eigen::VectorXd start_mean = Eigen::VectorXd::Zero(6), goal_mean = start_mean, start_square = start_mean;
  for (int i = 0; i < count; ++i) {
    const auto draw = sampler.value().Draw(rng);
    ASSERT_TRUE(draw.has_value());
    const Eigen::VectorXd reach = 0.6 * limits.velocity;
    EXPECT_TRUE(((draw->goal - draw->q).cwiseAbs().array() <= reach.array() + 1e-12).all());
    EXPECT_TRUE((draw->q.array() >= sampler.value().lower().array() - 1e-12).all());
    EXPECT_TRUE((draw->goal.array() <= sampler.value().upper().array() + 1e-12).all());
    EXPECT_EQ(draw->v.norm(), 0.0);
    start_mean += draw->q / count;
    goal_mean += draw->goal / count;
    start_square += draw->q.cwiseAbs2() / count;
  }
  const Eigen::VectorXd stddev = (start_square - start_mean.cwiseAbs2()).cwiseSqrt();
  EXPECT_TRUE(((start_mean - goal_mean).array().abs() < 0.05 * stddev.array()).all());
  const Eigen::VectorXd width = sampler.value().upper() - sampler.value().lower();
  EXPECT_TRUE((stddev.array() > 0.27 * width.array()).all()) << stddev.transpose();  // uniform: 0.289
}

TEST(StartGoalSampler, HomeRangeAndHeightHold) {
  const auto model = LoadRobot("mico2");
  SamplingOptions options;
  options.home = Candle();
  options.home_range = 0.7;
  options.min_height = 0.5;
  options.start_velocity_fraction = 0.5;
  auto sampler = StartGoalSampler::Create(*model, MotionLimits::FromModel(*model), 2.0, options);
  ASSERT_TRUE(sampler.ok());
  dynamics::Mechanism mechanism(*model);
  dynamics::Workspace workspace;
  const auto frame = *model->FindFrame(model->end_effector().name);
  Rng rng(2);
  double fastest = 0.0;
  for (int i = 0; i < 100; ++i) {
    const auto draw = sampler.value().Draw(rng);
    ASSERT_TRUE(draw.has_value());
    for (const Eigen::VectorXd* q : {&draw->q, &draw->goal}) {
      EXPECT_LE((*q - Candle()).lpNorm<Eigen::Infinity>(), 0.7 + 1e-12);
      EXPECT_GE(dynamics::FramePose(mechanism, workspace, *q, frame).translation.z(), 0.5);
    }
    fastest = std::max(fastest, draw->v.cwiseQuotient(model->VelocityLimits()).lpNorm<Eigen::Infinity>());
  }
  EXPECT_LE(fastest, 0.5);
  EXPECT_GT(fastest, 0.4);
}

TEST(StartGoalSampler, OneGoalForAllWithStartsInItsReach) {
  const auto model = LoadRobot("mico2");
  const MotionLimits limits = MotionLimits::FromModel(*model);
  SamplingOptions options;
  options.home = Candle();
  options.goal = Candle().array() + 0.4;
  auto sampler = StartGoalSampler::Create(*model, limits, 1.0, options);
  ASSERT_TRUE(sampler.ok()) << sampler.status().ToString();
  Rng rng(9);
  double farthest = 0.0;
  for (int i = 0; i < 200; ++i) {
    const auto draw = sampler.value().Draw(rng);
    EXPECT_EQ(draw->goal, options.goal);
    const Eigen::VectorXd share = (draw->q - draw->goal).cwiseAbs().cwiseQuotient(limits.velocity);
    farthest = std::max(farthest, share.maxCoeff());
  }
  EXPECT_LE(farthest, 0.6 + 1e-12);
  EXPECT_GT(farthest, 0.55);
  options.goal[1] = 9.0;
  const auto refused = StartGoalSampler::Create(*model, limits, 1.0, options);
  EXPECT_NE(refused.status().message().find("joint_2"), std::string::npos) << refused.status().message();
}

TEST(StartGoalSampler, RefusesWhatCannotBeDrawn) {
  const auto model = LoadRobot("mico2");
  const MotionLimits limits = MotionLimits::FromModel(*model);
  SamplingOptions options;
  options.position_margin = 3.0;
  const auto sampler = StartGoalSampler::Create(*model, limits, 1.0, options);
  ASSERT_FALSE(sampler.ok());
  EXPECT_NE(sampler.status().message().find("joint_2"), std::string::npos) << sampler.status().message();
  EXPECT_FALSE(StartGoalSampler::Create(*model, limits, 0.0, {}).ok());
  SamplingOptions high;
  high.min_height = 5.0;
  auto none = StartGoalSampler::Create(*model, limits, 1.0, high);
  ASSERT_TRUE(none.ok());
  Rng rng(1);
  EXPECT_FALSE(none.value().Draw(rng).has_value());
}

}  // namespace
}  // namespace rg::trajectories
