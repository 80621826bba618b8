#include "robot_agent/drivers/kinova/joint_report.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

namespace rg::robot_agent::kinova {
namespace {

using testing::HasSubstr;

const std::vector<std::string> kTwo = {"m1n6s200_joint_1", "m1n6s200_joint_2"};

TEST(PickJoints, LeavesFingersOutWhereverTheyStand) {
  const std::vector<std::string> names = {"m1n6s200_joint_finger_1", "m1n6s200_joint_2", "m1n6s200_joint_1",
                                          "m1n6s200_joint_finger_tip_1"};
  const std::vector<double> q = {9, 2, 1, 9}, v = {9, 4, 3, 9}, effort = {9, 6, 5, 9};
  JointReport report;
  ASSERT_TRUE(PickJoints({names, q, v, effort}, kTwo, &report).ok());
  EXPECT_EQ(report.q[0], 1);
  EXPECT_EQ(report.v[1], 4);
  EXPECT_EQ(report.effort[0], 5);
}

TEST(PickJoints, RefusesWhatIsMissingTwiceOrShort) {
  const std::vector<double> two = {1, 2}, one = {1};
  JointReport report;
  EXPECT_THAT(PickJoints({{"m1n6s200_joint_1", "x"}, two, two, two}, kTwo, &report).message(),
              HasSubstr("m1n6s200_joint_2"));
  EXPECT_THAT(PickJoints({{"m1n6s200_joint_1", "m1n6s200_joint_1"}, two, two, two}, kTwo, &report).message(),
              HasSubstr("twice"));
  EXPECT_THAT(PickJoints({kTwo, two, one, two}, kTwo, &report).message(), HasSubstr("1 velocities"));
}

TEST(CheckPlausible, NamesJointValueAndLimit) {
  JointReport report;
  report.effort = {0.1, 0.0};
  EXPECT_TRUE(CheckPlausible(report, kTwo).ok());
  report.q[1] = std::nan("");
  EXPECT_THAT(CheckPlausible(report, kTwo).message(), HasSubstr("m1n6s200_joint_2: position"));
  report.q[1] = 7.7;  // 440°
  EXPECT_TRUE(CheckPlausible(report, kTwo).ok());
  report.v[0] = 6.3 * 4;  // a doubled, wrapped velocity
  EXPECT_THAT(CheckPlausible(report, kTwo).message(), HasSubstr("m1n6s200_joint_1: velocity"));
}

TEST(CheckPlausible, KnowsAnArmThatIsNotInServiceMode) {
  EXPECT_THAT(CheckPlausible(JointReport{}, kTwo).message(), HasSubstr("service mode"));
}

TEST(JointsOfType, ReadsTheNamesOfTheFamily) {
  EXPECT_EQ(JointsOfType("m1n6s200").value(), 6);
  EXPECT_EQ(JointsOfType("j2n6s300").value(), 6);
  EXPECT_EQ(JointsOfType("j2n7s300").value(), 7);
  for (const char* wrong : {"", "mico2", "m1n9s200", "m1n6s2000", "x1n6s200"})
    EXPECT_FALSE(JointsOfType(wrong).ok()) << wrong;
}

}  // namespace
}  // namespace rg::robot_agent::kinova
