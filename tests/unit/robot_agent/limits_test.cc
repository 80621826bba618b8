#include "robot_agent/safety/limits.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace rg::robot_agent {
namespace {

using testing::HasSubstr;

const std::vector<std::string> kJoints{"shoulder", "elbow"};

SafetyLimits Good() {
  SafetyLimits limits;
  limits.lower = {-1, -1};
  limits.upper = {1, 1};
  limits.velocity = {1, 1};
  limits.torque = {5, 5};
  return limits;
}

TEST(SafetyLimits, GoodOnesPassAndSurviveJson) {
  SafetyLimits limits = Good();
  limits.task = {true, {-1, -1, 0}, {1, 1, 2}};
  limits.stale_s = 0.2;
  ASSERT_TRUE(ValidateLimits(limits, kJoints, {0, 0}).ok());
  const auto again = ParseLimits(LimitsToJson(limits), {}, "x").value();
  EXPECT_EQ(LimitsToJson(again), LimitsToJson(limits));
}

TEST(SafetyLimits, AbsentFieldsKeepTheirDefaults) {
  const auto limits = ParseLimits(R"({"torque": [1, 2]})", Good(), "x").value();
  EXPECT_EQ(limits.torque, (std::vector<double>{1, 2}));
  EXPECT_EQ(limits.upper, Good().upper);
}

TEST(SafetyLimits, ErrorsNameFieldJointAndValue) {
  SafetyLimits limits = Good();
  limits.upper[1] = -2;
  EXPECT_THAT(ValidateLimits(limits, kJoints, {}).message(), HasSubstr("elbow is [-1, -2]"));
  limits = Good();
  limits.velocity[0] = 0;
  EXPECT_THAT(ValidateLimits(limits, kJoints, {}).message(), HasSubstr("velocity of shoulder is 0"));
  EXPECT_THAT(ValidateLimits(Good(), kJoints, {0, 3}).message(), HasSubstr("elbow at 3"));
  limits = Good();
  limits.torque = {1};
  EXPECT_THAT(ValidateLimits(limits, kJoints, {}).message(), HasSubstr("torque has 1 entries for 2"));
  limits = Good();
  limits.task = {true, {0, 0, 1}, {1, 1, 0}};
  EXPECT_THAT(ValidateLimits(limits, kJoints, {}).message(), HasSubstr("along z"));
  EXPECT_THAT(ParseLimits(R"({"speed": 3})", Good(), "robot.json").status().message(),
              HasSubstr("robot.json: unknown field \"speed\""));
  EXPECT_FALSE(ParseLimits("{", Good(), "robot.json").ok());
}

}  // namespace
}  // namespace rg::robot_agent
