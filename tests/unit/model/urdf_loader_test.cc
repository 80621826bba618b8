#include "common/model/urdf_loader.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "common/base/file.h"
#include "common/base/rng.h"
#include "tests/support/base/comma_locale.h"
#include "tests/support/model/urdf_text.h"

namespace rg::model {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::StartsWith;
using testing_support::JointXml;
using testing_support::LinkXml;
using testing_support::RobotXml;

const LoadOptions kMicoArm = {.joints = {"joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6"},
                              .locked = {},
                              .end_effector = ""};

RobotModel Load(const std::string& name, const LoadOptions& options = {}) {
  auto model = LoadUrdf("deploy/robots/" + name, options);
  RG_CHECK(model.ok()) << model.status().ToString();
  return std::move(model).value();
}

TEST(UrdfLoader, KeepsAllFourteenLinksOfTheMico) {
  const RobotModel mico = Load("mico2.urdf", kMicoArm);
  EXPECT_EQ(mico.num_joints(), 6);
  EXPECT_EQ(mico.num_links(), 14);
  EXPECT_NEAR(mico.NominalLinkParameters().row(0).sum(), 4.353954, 1e-12);
  EXPECT_EQ(mico.link(mico.FindLink("world")).body, -1);
  EXPECT_EQ(mico.link(mico.FindLink("link_base")).body, -1);
  EXPECT_EQ(mico.link(mico.FindLink("link_finger_tip_2")).body, 5);
  EXPECT_FALSE(mico.link(mico.FindLink("end_effector")).has_inertial);
  EXPECT_EQ(mico.end_effector().name, "end_effector");
  EXPECT_TRUE(mico.warnings().empty());
}

TEST(UrdfLoader, ReadsLimitsAndDynamics) {
  const RobotModel mico = Load("mico2.urdf", kMicoArm);
  EXPECT_EQ(mico.joint(0).type, JointType::kContinuous);
  EXPECT_TRUE(std::isinf(mico.UpperLimits()[0]));
  EXPECT_NEAR(mico.LowerLimits()[1] * 180.0 / M_PI, 50.0, 1e-12);
  EXPECT_NEAR(mico.UpperLimits()[2] * 180.0 / M_PI, 325.0, 1e-12);
  EXPECT_EQ(mico.EffortLimits()[1], 80.0);
  EXPECT_NEAR(mico.VelocityLimits()[5] * 180.0 / M_PI, 48.0, 1e-12);
  const RobotModel arm = Load("arm2.urdf");
  EXPECT_EQ(arm.joint(0).damping, 0.1);
  EXPECT_EQ(arm.joint(1).friction, 0.0);
}

TEST(UrdfLoader, MovesAllTenJointsOfTheMicoUnlessTold) {
  const RobotModel mico = Load("mico2.urdf");
  EXPECT_EQ(mico.num_joints(), 10);
  EXPECT_EQ(mico.joint(mico.FindJoint("joint_finger_2")).parent, mico.FindJoint("joint_6"));
  EXPECT_EQ(mico.joint(mico.FindJoint("joint_finger_tip_2")).parent, mico.FindJoint("joint_finger_2"));
}

TEST(UrdfLoader, BodyFramesHaveTheAxisOnZ) {
  const RobotModel arm = Load("arm2.urdf");
  for (const Joint& joint : arm.joints()) {
    const Link& link = arm.link(joint.child_link);
    EXPECT_NEAR((link.X_BL.rotation * joint.axis - Eigen::Vector3d::UnitZ()).norm(), 0.0, 1e-15);
  }
  const RobotModel mico = Load("mico2.urdf", kMicoArm);
  for (const Joint& joint : mico.joints()) {
    EXPECT_TRUE(mico.link(joint.child_link).X_BL.rotation.isIdentity(0.0)) << joint.name;
  }
}

TEST(UrdfLoader, LockedJointsStandAtTheirValue) {
  const RobotModel moved =
      Load("arm2.urdf", {.joints = {}, .locked = {{"elbow", M_PI / 2}}, .end_effector = ""});
  EXPECT_EQ(moved.num_joints(), 1);
  const Frame tool = *moved.FindFrame("tool");
  EXPECT_EQ(tool.body, 0);
  // +90° about y turns "down" into -x: shoulder frame, link axes.
  const Eigen::Vector3d in_link =
      moved.link(moved.FindLink("upper_arm")).X_BL.rotation.transpose() * tool.X_BF.translation;
  EXPECT_NEAR((in_link - Eigen::Vector3d(-0.30, 0, -0.35)).norm(), 0.0, 1e-12);
}

TEST(UrdfLoader, AllShippedRobotsLoad) {
  for (const char* name : {"mico2.urdf", "arm2.urdf", "pendulum.urdf", "arm7.urdf", "slide.urdf"}) {
    const RobotModel model = Load(name);
    EXPECT_TRUE(model.warnings().empty()) << name << ": " << model.warnings()[0];
    EXPECT_FALSE(model.urdf_text().empty());
  }
  EXPECT_EQ(Load("arm7.urdf").num_joints(), 7);
  EXPECT_EQ(Load("slide.urdf").joint(0).type, JointType::kPrismatic);
  EXPECT_EQ(Load("arm7.urdf").end_effector().name, "tool");
}

TEST(UrdfLoader, LoadsTheSameWhereTheLocaleWritesCommas) {
  const RobotModel before = Load("mico2.urdf");
  const testing_support::CommaLocale comma;
  ASSERT_TRUE(comma.is_c_locale_set()) << "install the package locales";
  const RobotModel mico = Load("mico2.urdf");
  EXPECT_EQ(mico.NominalLinkParameters(), before.NominalLinkParameters());
  EXPECT_EQ(mico.UpperLimits(), before.UpperLimits());
  ASSERT_EQ(mico.num_joints(), before.num_joints());
  for (int k = 0; k < mico.num_joints(); ++k) {
    EXPECT_EQ(mico.joint(k).X_PB.translation, before.joint(k).X_PB.translation);
    EXPECT_EQ(mico.joint(k).X_PB.rotation, before.joint(k).X_PB.rotation);
  }
}

TEST(UrdfLoader, ANumberWithAPlusLosesNothing) {
  const auto with = [](const std::string& sign) {
    const std::string inertial = "<inertial><origin xyz='" + sign + R"(4.0e-3	0
 -.21 '/><mass value=" 2.4E+0 "/><inertia ixx="47.e-3" ixy="0" ixz="0" iyy=".046" iyz="0" izz="4E-03"/></inertial>)";
    return ParseUrdf(RobotXml(LinkXml("a") + LinkXml("b", inertial) + JointXml("j", "revolute", "a", "b")),
                     "a.urdf");
  };
  const auto plain = with(""), plus = with("+");
  ASSERT_TRUE(plain.ok() && plus.ok()) << plus.status().message();
  EXPECT_EQ(plus->NominalLinkParameters(), plain->NominalLinkParameters());
  const LinkParameters b = plus->link(1).parameters;
  EXPECT_EQ(b.head<4>(), Eigen::Vector4d(2.4, 0.004, 0.0, -0.21));
  EXPECT_EQ(b.segment<3>(4), Eigen::Vector3d(0.047, 0.046, 0.004));
}

TEST(UrdfLoader, WhatIsOutOfRangeTogetherIsRefused) {
  const std::string far = R"(<origin xyz="1e308 0 0"/>)";
  const auto model =
      ParseUrdf(RobotXml(LinkXml("a") + LinkXml("b") + LinkXml("c") + JointXml("f", "fixed", "a", "b", far) +
                         JointXml("j", "continuous", "b", "c", far)),
                "a.urdf");
  ASSERT_FALSE(model.ok());
  EXPECT_EQ(model.status().message(),
            "a.urdf: joint 'f': <origin xyz>: '1e308 0 0' is beyond any robot (SI units: kg, m, kg m^2)");
}

TEST(UrdfLoader, TurnedInertialOriginIsTakenToLinkAxes) {
  const auto model = ParseUrdf(R"(<robot name="r"><link name="a"/><link name="b"><inertial>
      <origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/><mass value="2"/>
      <inertia ixx="1" iyy="2" izz="2.5" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="j" type="continuous"><parent link="a"/><child link="b"/><axis xyz="0 0 3"/></joint></robot>)",
                               "turned.urdf");
  ASSERT_TRUE(model.ok()) << model.status().ToString();
  const LinkParameters p = model->link(1).parameters;
  EXPECT_NEAR(p[4], 2.0, 1e-12);
  EXPECT_NEAR(p[5], 1.0, 1e-12);
  EXPECT_EQ(model->joint(0).axis, Eigen::Vector3d::UnitZ());
}

TEST(UrdfLoader, WarnsOfInertiaThatNoBodyHas) {
  const auto model = ParseUrdf(R"(<robot name="r"><link name="a"/><link name="b"><inertial><mass value="2"/>
      <inertia ixx="1" iyy="1" izz="2.5" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint></robot>)",
                               "odd.urdf");
  ASSERT_TRUE(model.ok()) << model.status().ToString();
  EXPECT_THAT(model->warnings(),
              ElementsAre("odd.urdf: link 'b': the inertia breaks the triangle inequality (no body has it)"));
}

// --- Refusals: the message is the contract. -------------------------------------------------------

struct Refusal {
  const char* name;
  std::string xml;
  std::string message;
};

class UrdfRefusal : public testing::TestWithParam<Refusal> {};

TEST_P(UrdfRefusal, NamesSourceElementAndValue) {
  const auto model = ParseUrdf(GetParam().xml, "bad.urdf");
  ASSERT_FALSE(model.ok());
  EXPECT_EQ(model.status().code(), StatusCode::kInvalid);
  EXPECT_THAT(model.status().message(), StartsWith("bad.urdf: "));
  EXPECT_THAT(model.status().message(), HasSubstr(GetParam().message));
  EXPECT_EQ(model.status().message().find('\n'), std::string::npos);
}

const std::string kTwo = LinkXml("a") + LinkXml("b");

INSTANTIATE_TEST_SUITE_P(
    Each, UrdfRefusal,
    testing::ValuesIn(std::vector<Refusal>{
        {"NotXml", "<robot name='r'><link name='a'>", "not well-formed XML"},
        {"NoLinks", RobotXml(""), "<robot> has no links"},
        {"NothingMoves", RobotXml(LinkXml("a")), "no joint is left to move"},
        {"Floating", RobotXml(kTwo + JointXml("j", "floating", "a", "b")),
         "joint 'j': type 'floating' is not supported (revolute, continuous, prismatic, fixed)"},
        {"Planar", RobotXml(kTwo + JointXml("j", "planar", "a", "b")),
         "joint 'j': type 'planar' is not supported"},
        {"TwoParents",
         RobotXml(kTwo + LinkXml("c") + JointXml("j", "continuous", "a", "c") +
                  JointXml("k", "continuous", "b", "c")),
         "joint 'k': link 'c' already has the parent 'a': loops cannot be represented"},
        {"Ring",
         RobotXml(kTwo + JointXml("j", "continuous", "a", "b") + JointXml("k", "continuous", "b", "a")),
         "no root link: the joints form a loop"},
        {"DetachedRing",
         RobotXml(kTwo + LinkXml("c") + JointXml("j", "continuous", "c", "b") +
                  JointXml("k", "continuous", "b", "c")),
         "link 'b': is part of a loop of joints"},
        {"TwoRoots", RobotXml(kTwo), "links 'a' and 'b' are both roots"},
        {"LinkTwice", RobotXml(LinkXml("a") + LinkXml("a")), "link 'a': the name is used twice"},
        {"JointTwice",
         RobotXml(kTwo + LinkXml("c") + JointXml("j", "continuous", "a", "b") +
                  JointXml("j", "continuous", "b", "c")),
         "joint 'j': the name is used twice"},
        {"NoSuchLink", RobotXml(LinkXml("a") + JointXml("j", "fixed", "a", "x")),
         "joint 'j': child link 'x' does not exist"},
        {"NaNMass",
         RobotXml(
             LinkXml("a") +
             LinkXml(
                 "b",
                 R"(<inertial><mass value="nan"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>)") +
             JointXml("j", "continuous", "a", "b")),
         "link 'b': <mass value>: 'nan' is not finite"},
        {"NegativeMass",
         RobotXml(
             LinkXml("a") +
             LinkXml(
                 "b",
                 R"(<inertial><mass value="-2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>)") +
             JointXml("j", "continuous", "a", "b")),
         "link 'b': <mass value>: '-2' is negative"},
        {"TextAfterNumber",
         RobotXml(
             LinkXml("a") +
             LinkXml(
                 "b",
                 R"(<inertial><mass value="2kg"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>)") +
             JointXml("j", "continuous", "a", "b")),
         "link 'b': <mass value>: '2kg' is not a number"},
        {"NoInertiaEntry",
         RobotXml(
             LinkXml("a") +
             LinkXml(
                 "b",
                 R"(<inertial><mass value="2"/><inertia ixx="1" iyy="1" ixy="0" ixz="0" iyz="0"/></inertial>)") +
             JointXml("j", "continuous", "a", "b")),
         "link 'b': <inertia izz> is missing"},
        {"MasslessLeaf", RobotXml(LinkXml("a") + LinkXml("b", "") + JointXml("j", "continuous", "a", "b")),
         "nothing that moves has mass: no link that a joint moves has an <inertial> with mass above 0"},
        {"ZeroAxis", RobotXml(kTwo + JointXml("j", "continuous", "a", "b", R"(<axis xyz="0 0 0"/>)")),
         "joint 'j': <axis xyz>: '0 0 0' has no direction"},
        {"ShortAxis", RobotXml(kTwo + JointXml("j", "continuous", "a", "b", R"(<axis xyz="0 1"/>)")),
         "joint 'j': <axis xyz>: '0 1' is not 3 numbers"},
        {"NoLimits", RobotXml(kTwo + JointXml("j", "revolute", "a", "b", "")),
         "joint 'j': a revolute joint needs <limit>"},
        {"LimitsSwapped",
         RobotXml(kTwo + JointXml("j", "prismatic", "a", "b",
                                  R"(<limit lower="2" upper="1" effort="1" velocity="1"/>)")),
         "joint 'j': <limit>: lower 2 is above upper 1"},
        {"NoEffort",
         RobotXml(kTwo + JointXml("j", "revolute", "a", "b", R"(<limit lower="0" upper="1" velocity="1"/>)")),
         "joint 'j': <limit effort> is missing"},
        {"NegativeDamping",
         RobotXml(kTwo + JointXml("j", "continuous", "a", "b", R"(<dynamics damping="-1"/>)")),
         "joint 'j': <dynamics damping>: '-1' is negative"},
        {"InfiniteOrigin",
         RobotXml(kTwo + JointXml("j", "continuous", "a", "b", R"(<origin xyz="0 inf 0"/>)")),
         "joint 'j': <origin xyz>: '0 inf 0' is not finite"},
        {"OriginTwice",
         RobotXml(kTwo +
                  JointXml("j", "continuous", "a", "b", R"(<origin xyz="0 0 0"/><origin xyz="0 0 1"/>)")),
         "joint 'j': <origin> is there twice"},
    }),
    [](const auto& info) { return std::string(info.param.name); });

TEST(UrdfLoader, SurvivesDamagedDocuments) {
  const std::string original = ReadFile("deploy/robots/mico2.urdf").value();
  Rng rng(17);
  int accepted = 0;
  for (int i = 0; i < 1500; ++i) {
    std::string text = original;
    for (uint64_t hits = 1 + rng.Index(4); hits > 0; --hits) {
      const size_t at = rng.Index(text.size());
      switch (rng.Index(4)) {
        case 0:
          text[at] = static_cast<char>(rng.Index(256));
          break;
        case 1:
          text.erase(at, rng.Index(40));
          break;
        case 2:
          text.insert(at, text.substr(rng.Index(text.size()), rng.Index(200)));
          break;
        default:
          text[at] = "0123456789.-e<>/\"="[rng.Index(18)];
      }
    }
    const auto model = ParseUrdf(text, "damaged.urdf");
    if (model.ok()) {
      ++accepted;
      EXPECT_TRUE(model->NominalLinkParameters().allFinite());
      EXPECT_TRUE(model->LowerLimits().size() == model->num_joints());
    } else {
      EXPECT_THAT(model.status().message(), StartsWith("damaged.urdf: "));
    }
  }
  EXPECT_GT(accepted, 100);  // damage to comments and digits leaves a robot
  EXPECT_LT(accepted, 1400);
}

TEST(UrdfLoader, RefusesSeventeenMovingJoints) {
  std::string body = LinkXml("l0");
  for (int i = 1; i <= 17; ++i) {
    body += LinkXml("l" + std::to_string(i)) + JointXml("j" + std::to_string(i), "continuous",
                                                        "l" + std::to_string(i - 1), "l" + std::to_string(i));
  }
  const auto model = ParseUrdf(RobotXml(body), "long.urdf");
  ASSERT_FALSE(model.ok());
  EXPECT_EQ(model.status().message(), "long.urdf: joint 'j17': more than 16 moving joints (lock some)");
  EXPECT_TRUE(
      ParseUrdf(RobotXml(body), "long.urdf", {.joints = {}, .locked = {{"j4", 0.5}}, .end_effector = ""})
          .ok());
}

TEST(UrdfLoader, RefusesOptionsThatNameNothing) {
  const std::string xml = RobotXml(kTwo + JointXml("j", "continuous", "a", "b"));
  const auto refuse = [&](const LoadOptions& options) {
    return ParseUrdf(xml, "r.urdf", options).status().message();
  };
  EXPECT_EQ(refuse({.joints = {"k"}, .locked = {}, .end_effector = ""}), "r.urdf: joint 'k' does not exist");
  EXPECT_EQ(refuse({.joints = {}, .locked = {{"k", 0.0}}, .end_effector = ""}),
            "r.urdf: locked joint 'k' does not exist");
  EXPECT_EQ(refuse({.joints = {"j"}, .locked = {{"j", 0.0}}, .end_effector = ""}),
            "r.urdf: joint 'j' is both moving and locked");
  EXPECT_EQ(refuse({.joints = {}, .locked = {}, .end_effector = "hand"}),
            "r.urdf: end effector link 'hand' does not exist");
}

TEST(UrdfLoader, SaysWhichFileIsMissing) {
  const auto model = LoadUrdf("no/such/arm.urdf");
  ASSERT_FALSE(model.ok());
  EXPECT_THAT(model.status().message(), HasSubstr("no/such/arm.urdf"));
}

}  // namespace
}  // namespace rg::model
