#include "common/model/joint_inertia.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/model/urdf_loader.h"
#include "tests/support/model/urdf_text.h"

namespace rg::model {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;
using testing_support::JointXml;
using testing_support::LinkXml;
using testing_support::MimicXml;
using testing_support::RobotXml;

RobotModel Parsed(const std::string& xml) {
  auto model = ParseUrdf(xml, "a.urdf");
  RG_CHECK(model.ok()) << model.status().message();
  return std::move(model).value();
}

// Inertial with a centre of mass and principal moments.
std::string Inertial(double mass, const std::string& com, const std::string& xx, const std::string& yy,
                     const std::string& zz, const std::string& rpy = "0 0 0") {
  return "<inertial><origin xyz='" + com + "' rpy='" + rpy + "'/><mass value='" + std::to_string(mass) +
         "'/><inertia ixx='" + xx + "' iyy='" + yy + "' izz='" + zz +
         "' ixy='0' ixz='0' iyz='0'/></inertial>";
}
const std::string kAboutZ = "<axis xyz='0 0 1'/>";

// An arm link on `base`, and a flange on it that turns about z.
std::string ArmWithFlange(const std::string& flange) {
  return RobotXml(LinkXml("base") + LinkXml("arm", Inertial(2, "0 0 .2", ".1", ".1", ".01")) +
                  LinkXml("flange", flange) +
                  JointXml("j5", "continuous", "base", "arm", "<axis xyz='0 1 0'/>") +
                  JointXml("j6", "continuous", "arm", "flange", "<origin xyz='0 0 .4'/>" + kAboutZ));
}

TEST(JointInertia, AFlangeWithoutInertialIsFoundAndSaid) {
  const RobotModel model = Parsed(ArmWithFlange(""));
  EXPECT_THAT(model.joints_without_inertia(), ElementsAre(1));
  EXPECT_THAT(model.warnings(),
              ElementsAre("a.urdf: joint 'j6' moves link 'flange', which has no mass: simulating it "
                          "needs its drive's rotor inertia"));
}

TEST(JointInertia, APointMassOnTheAxisIsFoundAndSaid) {
  const RobotModel model = Parsed(ArmWithFlange(Inertial(0.3, "0 0 .05", "0", "0", "0")));
  EXPECT_THAT(model.joints_without_inertia(), ElementsAre(1));
  EXPECT_THAT(model.warnings(),
              ElementsAre("a.urdf: joint 'j6' moves link 'flange', which has no inertia about its "
                          "axis: simulating it needs its drive's rotor inertia"));
}

TEST(JointInertia, RoundingOfATurnedInertiaIsNone) {
  // A thin rod along z, given in turned axes: about z its inertia is 0 only to rounding.
  const RobotModel model =
      Parsed(ArmWithFlange(Inertial(0.3, "0 0 .05", ".02", "0", ".02", "1.5707963267948966 0 .3")));
  EXPECT_NE(model.link(2).parameters[6], 0.0);
  EXPECT_LT(std::abs(model.link(2).parameters[6]), 1e-16);
  EXPECT_THAT(model.joints_without_inertia(), ElementsAre(1));
}

TEST(JointInertia, ASmallInertiaIsOne) {
  EXPECT_THAT(Parsed(ArmWithFlange(Inertial(0.01, "0 0 0", "1e-7", "1e-7", "1e-8"))).joints_without_inertia(),
              IsEmpty());
  EXPECT_THAT(Parsed(ArmWithFlange(Inertial(0.01, "1e-3 0 0", "0", "0", "0"))).joints_without_inertia(),
              IsEmpty());
}

TEST(JointInertia, TheLinksOfAFixedJointCount) {
  const std::string xml = RobotXml(
      LinkXml("base") + LinkXml("flange", "") + LinkXml("tool", Inertial(1, "0 0 0", "1", "1", "1")) +
      JointXml("j6", "continuous", "base", "flange", kAboutZ) + JointXml("f", "fixed", "flange", "tool"));
  EXPECT_THAT(Parsed(xml).joints_without_inertia(), IsEmpty());
}

TEST(JointInertia, AMasslessLinkBetweenTwoAxesIsFineUnlessTheyAreOne) {
  const auto gimbal = [](const std::string& second_axis) {
    return RobotXml(LinkXml("base") + LinkXml("ring", "") +
                    LinkXml("tool", Inertial(1, ".1 .2 .3", "1", "1", "1")) +
                    JointXml("outer", "continuous", "base", "ring", kAboutZ) +
                    JointXml("inner", "continuous", "ring", "tool", "<axis xyz='" + second_axis + "'/>"));
  };
  EXPECT_THAT(Parsed(gimbal("1 0 0")).joints_without_inertia(), IsEmpty());
  EXPECT_THAT(Parsed(gimbal("0 0 1")).joints_without_inertia(), ElementsAre(0));
  EXPECT_THAT(Parsed(gimbal("0 0 -2")).joints_without_inertia(), ElementsAre(0));
}

TEST(JointInertia, ASlideNeedsMassAndNoInertia) {
  const auto slide = [](const std::string& carriage) {
    return RobotXml(LinkXml("base") + LinkXml("arm") + LinkXml("carriage", carriage) +
                    JointXml("j", "continuous", "base", "arm", "") +
                    JointXml("slide", "prismatic", "arm", "carriage"));
  };
  EXPECT_THAT(Parsed(slide("")).joints_without_inertia(), ElementsAre(1));
  EXPECT_THAT(Parsed(slide(Inertial(0, "0 0 0", "1", "1", "1"))).joints_without_inertia(), ElementsAre(1));
  EXPECT_THAT(Parsed(slide(Inertial(1, "0 0 0", "0", "0", "0"))).joints_without_inertia(), IsEmpty());
}

TEST(JointInertia, AFollowersInertiaIsItsDrivers) {
  const auto hand = [](const std::string& follower) {
    return RobotXml(LinkXml("base") + LinkXml("a") + LinkXml("left", "") + LinkXml("right", follower) +
                    JointXml("arm", "continuous", "base", "a", "") +
                    JointXml("d", "continuous", "a", "left", kAboutZ) +
                    JointXml("m", "continuous", "a", "right", kAboutZ + MimicXml("d", "multiplier='-1'")));
  };
  EXPECT_THAT(Parsed(hand(Inertial(1, ".1 0 0", "0", "0", "0"))).joints_without_inertia(), IsEmpty());
  const RobotModel none = Parsed(hand(""));
  ASSERT_EQ(none.followers().size(), 1u);
  EXPECT_THAT(none.joints_without_inertia(), ElementsAre(none.FindJoint("d")));
}

TEST(JointInertia, TheShippedRobotsHaveAll) {
  for (const char* name : {"mico2.urdf", "arm2.urdf", "pendulum.urdf", "arm7.urdf", "slide.urdf"}) {
    const auto model = LoadUrdf(std::string("deploy/robots/") + name);
    ASSERT_TRUE(model.ok());
    EXPECT_THAT(model->joints_without_inertia(), IsEmpty()) << name;
  }
}

}  // namespace
}  // namespace rg::model
