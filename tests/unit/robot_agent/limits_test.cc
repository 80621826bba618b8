#include "robot_agent/safety/limits.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

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
  limits.torque_rate = {100, 100};
  return limits;
}

std::string WithSpeed() {
  auto json = nlohmann::json::parse(LimitsToJson(Good()));
  json["speed"] = 3;
  return json.dump();
}

TEST(SafetyLimits, GoodOnesPassAndSurviveJson) {
  SafetyLimits limits = Good();
  limits.task = {true, {-1, -1, 0}, {1, 1, 2}};
  limits.stale_s = 0.2;
  ASSERT_TRUE(ValidateLimits(limits, kJoints, {0, 0}).ok());
  const auto again = ParseLimits(LimitsToJson(limits), "x").value();
  EXPECT_EQ(LimitsToJson(again), LimitsToJson(limits));
}

TEST(SafetyLimits, EachOneThatIsMissingIsNamed) {
  for (const char* name : {"lower", "upper", "velocity", "torque", "torque_rate", "task_box"}) {
    auto json = nlohmann::json::parse(LimitsToJson(Good()));
    json.erase(name);
    EXPECT_THAT(ParseLimits(json.dump(), "robot.json").status().message(),
                HasSubstr("robot.json: \"" + std::string(name) + "\" is missing"));
  }
}

TEST(SafetyLimits, AJobMakesThemTighterNeverWider) {
  TighterLimits asked;
  asked.lower = {-0.5, -9};
  asked.upper = {9, 0.5};
  asked.velocity = {9, 0.1};
  asked.torque = {2, INFINITY};
  const SafetyLimits tighter = Tighten(Good(), asked, kJoints).value();
  EXPECT_EQ(tighter.lower, (std::vector<double>{-0.5, -1}));
  EXPECT_EQ(tighter.upper, (std::vector<double>{1, 0.5}));
  EXPECT_EQ(tighter.velocity, (std::vector<double>{1, 0.1}));
  EXPECT_EQ(tighter.torque, (std::vector<double>{2, 5}));
  EXPECT_EQ(tighter.torque_rate, Good().torque_rate);
  EXPECT_EQ(LimitsToJson(Tighten(Good(), {}, kJoints).value()), LimitsToJson(Good()));
}

TEST(SafetyLimits, AJobThatLeavesNoRoomOrAsksForNonsenseIsRefused) {
  TighterLimits asked;
  asked.lower = {2, 0};
  EXPECT_THAT(Tighten(Good(), asked, kJoints).status().message(), HasSubstr("position box of shoulder"));
  asked.lower = {std::nan(""), 0};
  EXPECT_THAT(Tighten(Good(), asked, kJoints).status().message(), HasSubstr("lower limit of shoulder"));
  asked.lower = {0};
  EXPECT_FALSE(Tighten(Good(), asked, kJoints).ok());
  asked.lower.clear();
  asked.torque = {-1, 1};
  EXPECT_THAT(Tighten(Good(), asked, kJoints).status().message(), HasSubstr("torque of shoulder is -1"));
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
  EXPECT_THAT(ParseLimits(WithSpeed(), "robot.json").status().message(),
              HasSubstr("robot.json: unknown field \"speed\""));
  EXPECT_FALSE(ParseLimits("{", "robot.json").ok());
}

}  // namespace
}  // namespace rg::robot_agent
