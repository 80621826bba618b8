#include "common/model/joint_motion.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

#include "tests/support/model/urdf_text.h"

namespace rg::model {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;
using testing_support::JointXml;
using testing_support::LinkXml;
using testing_support::MimicXml;
using testing_support::RobotXml;

// Links base, then one on each joint, all on the base; `d` drives unless told.
std::string Hand(const std::vector<std::pair<std::string, std::string>>& joints) {
  std::string body = LinkXml("base");
  for (const auto& [name, inside] : joints) {
    body += LinkXml("on_" + name) + JointXml(name, "continuous", "base", "on_" + name, inside);
  }
  return RobotXml(body);
}

Result<RobotModel> TryParse(const std::string& xml, const std::vector<std::string>& joints = {},
                        const std::map<std::string, double>& locked = {}) {
  return ParseUrdf(xml, "a.urdf", {.joints = joints, .locked = locked, .end_effector = ""});
}

std::string ErrorOf(const Result<RobotModel>& model) { return model.ok() ? "" : model.status().message(); }

// The angle about x, the default axis, at which a link on the base stands.
double StandsAt(const RobotModel& model, const std::string& link) {
  const Eigen::Matrix3d& R = model.link(model.FindLink(link)).X_BL.rotation;
  return std::atan2(R(2, 1), R(1, 1));
}

TEST(JointMotion, AMimicOfAMovingJointIsAFollower) {
  for (const std::vector<std::string>& joints : {std::vector<std::string>{}, {"d", "e"}}) {
    const auto model =
        TryParse(Hand({{"m", MimicXml("d", "multiplier='-2' offset='.5'")}, {"e", ""}, {"d", ""}}), joints);
    ASSERT_TRUE(model.ok()) << model.status().message();
    EXPECT_EQ(model->num_joints(), 2);
    EXPECT_EQ(model->num_bodies(), 3);
    EXPECT_EQ(model->FindJoint("m"), -1);
    ASSERT_EQ(model->FindFollower("m"), 0);
    const Follower& follower = model->followers()[0];
    EXPECT_EQ(follower.driver, model->FindJoint("d"));
    EXPECT_EQ(follower.multiplier, -2.0);
    EXPECT_EQ(follower.offset, 0.5);
    EXPECT_EQ(model->link(model->FindLink("on_m")).body, 2);
    EXPECT_EQ(&model->body_joint(2), &follower.joint);
    EXPECT_THAT(model->warnings(), IsEmpty());
  }
}

TEST(JointMotion, AMultiplierOf1AndAnOffsetOf0AreTheDefault) {
  const auto model = TryParse(Hand({{"d", ""}, {"m", MimicXml("d")}}));
  ASSERT_TRUE(model.ok());
  EXPECT_EQ(model->followers()[0].multiplier, 1.0);
  EXPECT_EQ(model->followers()[0].offset, 0.0);
}

TEST(JointMotion, ChainsOfMimicsLeadToTheirDriver) {
  const auto model = TryParse(Hand({{"third", MimicXml("second", "multiplier='3' offset='1'")},
                                {"first", MimicXml("d", "multiplier='2' offset='.25'")},
                                {"second", MimicXml("first", "multiplier='-1' offset='.5'")},
                                {"d", ""}}));
  ASSERT_TRUE(model.ok()) << model.status().message();
  const Follower& third = model->followers()[model->FindFollower("third")];
  // q3 = 3 (-1 (2 d + 0.25) + 0.5) + 1
  EXPECT_EQ(third.driver, 0);
  EXPECT_DOUBLE_EQ(third.multiplier, -6.0);
  EXPECT_DOUBLE_EQ(third.offset, 1.75);
}

TEST(JointMotion, JointsMayHangOnFollowersAndFollowersOnThem) {
  const std::string xml = RobotXml(LinkXml("base") + LinkXml("a") + LinkXml("b") + LinkXml("c") +
                                   JointXml("m", "continuous", "base", "a", MimicXml("d")) +
                                   JointXml("d", "continuous", "a", "b", "") +
                                   JointXml("m2", "continuous", "b", "c", MimicXml("d")));
  const auto model = TryParse(xml);
  ASSERT_TRUE(model.ok()) << model.status().message();
  EXPECT_EQ(model->joint(0).parent, 1);  // m's body
  EXPECT_EQ(model->followers()[0].joint.parent, -1);
  EXPECT_EQ(model->followers()[1].joint.parent, 0);
}

// shared/cases/02_mimic_gripper: the driver is locked at 0.8, so its mimic stands at 0.05 - 0.8.
TEST(JointMotion, AMimicOfAStandingJointStandsWithItAndIsSaid) {
  const std::string xml = RobotXml(
      LinkXml("base") + LinkXml("forearm") + LinkXml("left") + LinkXml("right") +
      JointXml("elbow", "revolute", "base", "forearm") +
      JointXml(
          "gripper_joint", "revolute", "forearm", "left",
          R"(<origin xyz="-0.02 0 -0.32"/><axis xyz="0 1 0"/><limit lower="0" upper="1.2" effort="5" velocity="2"/>)") +
      JointXml(
          "gripper_right_mimic", "continuous", "forearm", "right",
          R"(<origin xyz="0.02 0 -0.32"/><axis xyz="0 1 0"/><mimic joint="gripper_joint" multiplier="-1" offset="0.05"/>)"));
  const auto model = TryParse(xml, {"elbow"}, {{"gripper_joint", 0.8}});
  ASSERT_TRUE(model.ok()) << model.status().message();
  EXPECT_EQ(model->num_bodies(), 1);
  const Pose X_FR = model->FindFrame("forearm")->X_BF.Inverse() * model->FindFrame("right")->X_BF;
  const Eigen::Matrix3d expected = Eigen::AngleAxisd(-0.75, Eigen::Vector3d::UnitY()).toRotationMatrix();
  EXPECT_NEAR((X_FR.rotation - expected).norm(), 0.0, 1e-15);
  EXPECT_NEAR((X_FR.translation - Eigen::Vector3d(0.02, 0, -0.32)).norm(), 0.0, 1e-15);
  EXPECT_THAT(model->warnings(),
              ElementsAre("a.urdf: joint 'gripper_right_mimic' stands at -0.75: it mimics joint "
                          "'gripper_joint', which stands at 0.8"));
}

TEST(JointMotion, ADriverWithoutColumnsStandsAt0AndItsMimicAtTheOffset) {
  const auto model = TryParse(Hand({{"e", ""},
                                {"d", ""},
                                {"m", MimicXml("d", "multiplier='7' offset='.25'")},
                                {"m2", MimicXml("m", "multiplier='2'")}}),
                          {"e"});
  ASSERT_TRUE(model.ok()) << model.status().message();
  EXPECT_NEAR(StandsAt(*model, "on_m"), 0.25, 1e-15);
  EXPECT_NEAR(StandsAt(*model, "on_m2"), 0.5, 1e-15);
  EXPECT_THAT(model->warnings(),
              ElementsAre("a.urdf: joint 'm' stands at 0.25: it mimics joint 'd', which stands at 0",
                          "a.urdf: joint 'm2' stands at 0.5: it mimics joint 'm', which stands at 0.25"));
}

TEST(JointMotion, APrismaticMimicOfAnAngleStandsAtItsWay) {
  const std::string xml =
      RobotXml(LinkXml("base") + LinkXml("a") + LinkXml("b") + LinkXml("c") +
               JointXml("e", "continuous", "base", "c", "") + JointXml("d", "continuous", "base", "a", "") +
               JointXml("m", "prismatic", "base", "b",
                        "<axis xyz='0 0 2'/><limit lower='0' upper='1' effort='1' velocity='1'/>" +
                            MimicXml("d", "multiplier='.1' offset='.02'")));
  const auto model = TryParse(xml, {"e"}, {{"d", 0.5}});
  ASSERT_TRUE(model.ok()) << model.status().message();
  EXPECT_NEAR((model->FindFrame("b")->X_BF.translation - Eigen::Vector3d(0, 0, 0.07)).norm(), 0.0, 1e-15);
}

TEST(JointMotion, AMultiplierOf0StandsAtTheOffset) {
  const auto model = TryParse(Hand({{"d", ""}, {"m", MimicXml("d", "multiplier='0' offset='.3'")}}));
  ASSERT_TRUE(model.ok()) << model.status().message();
  EXPECT_EQ(model->num_bodies(), 1);
  EXPECT_NEAR(StandsAt(*model, "on_m"), 0.3, 1e-15);
  EXPECT_THAT(model->warnings(),
              ElementsAre("a.urdf: joint 'm' stands at 0.3: it mimics joint 'd' with multiplier 0"));
}

TEST(JointMotion, ALockedMimicStandsWhereItIsLockedAndAContradictionIsSaid) {
  const std::string xml = Hand({{"e", ""}, {"d", ""}, {"m", MimicXml("d", "offset='.1'")}});
  auto model = TryParse(xml, {}, {{"m", 0.4}});
  ASSERT_TRUE(model.ok()) << model.status().message();
  EXPECT_EQ(model->num_joints(), 2);
  EXPECT_NEAR(StandsAt(*model, "on_m"), 0.4, 1e-15);
  EXPECT_THAT(model->warnings(),
              ElementsAre("a.urdf: joint 'm' is locked at 0.4, although it mimics joint 'd', which moves"));
  model = TryParse(xml, {"e"}, {{"d", 0.2}, {"m", 0.4}});
  ASSERT_TRUE(model.ok()) << model.status().message();
  EXPECT_NEAR(StandsAt(*model, "on_m"), 0.4, 1e-15);
  ASSERT_EQ(model->warnings().size(), 1u);
  EXPECT_THAT(
      model->warnings()[0],
      testing::StartsWith("a.urdf: joint 'm' is locked at 0.4, although it mimics joint 'd', which would "
                          "have it at 0.3"));
  model = TryParse(xml, {"e"}, {{"d", 0.25}, {"m", 0.35}});
  ASSERT_TRUE(model.ok());
  EXPECT_THAT(model->warnings(), IsEmpty());
}

TEST(JointMotion, AMimicAmongTheJointsFollowsAllTheSameAndIsSaid) {
  const auto model = TryParse(Hand({{"d", ""}, {"m", MimicXml("d")}}), {"m", "d"});
  ASSERT_TRUE(model.ok()) << model.status().message();
  EXPECT_EQ(model->num_joints(), 1);
  EXPECT_EQ(model->followers().size(), 1u);
  EXPECT_THAT(model->warnings(),
              ElementsAre("a.urdf: joint 'm': it mimics joint 'd' and moves with it; its own "
                          "columns are not used"));
}

TEST(JointMotion, WhatCannotFollowIsRefusedByName) {
  EXPECT_EQ(ErrorOf(TryParse(Hand({{"d", ""}, {"m", MimicXml("x")}}))),
            "a.urdf: joint 'm' mimics joint 'x', which does not exist");
  EXPECT_TRUE(TryParse(Hand({{"d", ""}, {"m", MimicXml("x")}}), {}, {{"m", 0.1}}).ok());
  EXPECT_EQ(ErrorOf(TryParse(Hand({{"d", ""}, {"m", MimicXml("m")}}))), "a.urdf: joint 'm' mimics itself");
  EXPECT_EQ(
      ErrorOf(TryParse(Hand({{"d", ""}, {"p", MimicXml("q")}, {"q", MimicXml("r")}, {"r", MimicXml("q")}}))),
      "a.urdf: joint 'q' mimics itself, through other mimic joints");
  EXPECT_EQ(
      ErrorOf(TryParse(Hand({{"d", ""}, {"e", ""}, {"m", MimicXml("d")}}), {"e", "m"})),
      "a.urdf: joint 'm' cannot move: it mimics joint 'd', which stands (name that among the joints that "
      "move)");
  EXPECT_EQ(ErrorOf(TryParse(Hand({{"d", ""},
                               {"m", MimicXml("d", "multiplier='1e200'")},
                               {"k", MimicXml("m", "multiplier='1e200'")}}))),
            "a.urdf: joint 'k': <mimic>: its position is out of a double's range");
}

TEST(JointMotion, FollowersCountAmongTheBodies) {
  std::vector<std::pair<std::string, std::string>> joints = {{"d", ""}};
  for (int i = 1; i <= 16; ++i) joints.push_back({"m" + std::to_string(i), MimicXml("d")});
  EXPECT_EQ(ErrorOf(TryParse(Hand(joints))),
            "a.urdf: joint 'm16': more than 16 moving joints, mimic joints included (lock some)");
  EXPECT_TRUE(TryParse(Hand(joints), {}, {{"m3", 0.0}}).ok());
}

TEST(JointMotion, LongChainsTakeNoStack) {
  std::string body = LinkXml("l0") + LinkXml("moved") + JointXml("j0", "continuous", "l0", "moved", "");
  for (int i = 1; i <= 20000; ++i) {
    const std::string n = std::to_string(i), before = std::to_string(i - 1);
    body += LinkXml("l" + n, "") +
            JointXml("j" + n, "continuous", "l" + before, "l" + n, MimicXml("j" + before, "multiplier='.5'"));
  }
  const auto model = TryParse(RobotXml(body), {"j0"}, {{"j1", 0.0}});
  ASSERT_TRUE(model.ok()) << model.status().message();
  EXPECT_EQ(model->num_links(), 20002);
  EXPECT_EQ(model->num_bodies(), 1);
}

}  // namespace
}  // namespace rg::model
