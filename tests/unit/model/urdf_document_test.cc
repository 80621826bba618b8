#include "common/model/urdf_document.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <urdf_parser/urdf_parser.h>

#include <Eigen/Geometry>
#include <vector>

#include "common/base/file.h"
#include "tests/support/base/comma_locale.h"
#include "tests/support/model/urdf_text.h"

namespace rg::model {
namespace {

using testing_support::JointXml;
using testing_support::LinkXml;
using testing_support::RobotXml;

UrdfDocument Read(const std::string& xml) {
  auto document = ReadUrdfDocument(xml, "a.urdf");
  RG_CHECK(document.ok()) << document.status().message();
  return std::move(document).value();
}

// shared/cases/05_numbers_and_locale: each of these spellings lost an element somewhere.
const char* const kSpellings = R"(<?xml version="1.0" encoding="utf-8"?>
<robot name="numbers">
  <link name="base"/>
  <link name="upper"><inertial>
    <origin xyz="  +4.0e-3	0
       -.21 " rpy="0 -0 0."/>
    <mass value=" 2.4E+0 "/><inertia ixx="47.e-3" ixy="0" ixz="0" iyy=".046" iyz="0" izz="4E-03"/></inertial></link>
  <link name="forearm"><inertial>
    <origin xyz="-3e-3 0 -0.17000000000000000000000001"/>
    <mass value="1.3"/><inertia ixx="2.15e-2" ixy="0.0" ixz="0.0" iyy="0.0210000" iyz="0.0" izz="1.8e-3"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 .9"/>
    <axis xyz="0 1. 0"/><limit lower="-3." upper="+3." effort="4e1" velocity="8"/><dynamics damping="+1e-1"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="forearm"/><origin xyz="0  0  -45e-2" rpy="0 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="15" velocity="10"/>
    <mimic joint="shoulder" multiplier=" -.5 " offset="+5.E-2"/></joint>
</robot>)";

void ExpectTheSpellingsAreRead() {
  const UrdfDocument d = Read(kSpellings);
  ASSERT_EQ(d.links.size(), 3u);
  ASSERT_TRUE(d.links[1].inertial && d.links[2].inertial);
  const UrdfInertial& upper = *d.links[1].inertial;
  EXPECT_EQ(upper.origin.translation, Eigen::Vector3d(0.004, 0, -0.21));
  EXPECT_TRUE(upper.origin.rotation.isIdentity(0.0));
  EXPECT_EQ(upper.mass, 2.4);
  EXPECT_EQ(upper.inertia, Eigen::Matrix3d(Eigen::Vector3d(0.047, 0.046, 0.004).asDiagonal()));
  EXPECT_EQ(d.links[2].inertial->origin.translation, Eigen::Vector3d(-0.003, 0, -0.17));
  const UrdfJoint &shoulder = d.joints[0], &elbow = d.joints[1];
  EXPECT_EQ(shoulder.origin.translation, Eigen::Vector3d(0, 0, 0.9));
  EXPECT_EQ(shoulder.axis, Eigen::Vector3d(0, 1, 0));
  EXPECT_EQ(shoulder.lower, -3.0);
  EXPECT_EQ(shoulder.upper, 3.0);
  EXPECT_EQ(shoulder.effort, 40.0);
  EXPECT_EQ(shoulder.velocity, 8.0);
  EXPECT_EQ(shoulder.damping, 0.1);
  EXPECT_EQ(elbow.origin.translation, Eigen::Vector3d(0, 0, -0.45));
  ASSERT_TRUE(elbow.mimic);
  EXPECT_EQ(elbow.mimic->driver, "shoulder");
  EXPECT_EQ(elbow.mimic->multiplier, -0.5);
  EXPECT_EQ(elbow.mimic->offset, 0.05);
  EXPECT_TRUE(d.warnings.empty()) << d.warnings[0];
}

TEST(UrdfDocument, ReadsNumbersInTheSpellingsOfXmlWriters) { ExpectTheSpellingsAreRead(); }

TEST(UrdfDocument, ReadsTheSameWhereTheLocaleWritesCommas) {
  const testing_support::CommaLocale comma;
  ASSERT_TRUE(comma.is_c_locale_set()) << "install the package locales";
  ExpectTheSpellingsAreRead();
}

TEST(UrdfDocument, HoldsTheTreeInTheOrderOfTheDocument) {
  const UrdfDocument d =
      Read(RobotXml(LinkXml("c") + LinkXml("a") + LinkXml("b") + JointXml("k", "fixed", "b", "c") +
                    JointXml("j", "revolute", "b", "a")));
  EXPECT_THAT(d.JointNames(), testing::ElementsAre("k", "j"));
  EXPECT_EQ(d.root, 2);
  EXPECT_EQ(d.child_joints[2], (std::vector<int>{0, 1}));
  EXPECT_TRUE(d.joints[0].is_fixed);
  EXPECT_EQ(d.joints[1].child, 1);
}

TEST(UrdfDocument, ReadsTheQuaternionOfNewerUrdfAndSaysSo) {
  const std::string in_joint = R"(<origin xyz="0 0 1" quat_xyzw="0 0 .6 .8"/>)";
  const UrdfDocument d =
      Read(RobotXml(LinkXml("a") + LinkXml("b") + JointXml("j", "continuous", "a", "b", in_joint)));
  const Eigen::Matrix3d expected =
      Eigen::AngleAxisd(2.0 * std::atan2(0.6, 0.8), Eigen::Vector3d::UnitZ()).toRotationMatrix();
  EXPECT_NEAR((d.joints[0].origin.rotation - expected).norm(), 0.0, 1e-15);
  EXPECT_THAT(d.warnings,
              testing::ElementsAre("a.urdf: joint 'j': <origin quat_xyzw> is taken as the rotation, "
                                   "which older readers of URDF do not do"));
}

TEST(UrdfDocument, SaysWhatMayBeDegrees) {
  const UrdfDocument d = Read(RobotXml(LinkXml("a") + LinkXml("b") +
                                       JointXml("j", "continuous", "a", "b", R"(<origin rpy="0 0 90"/>)")));
  EXPECT_THAT(d.warnings,
              testing::ElementsAre(
                  "a.urdf: joint 'j': <origin rpy>: '0 0 90' is more than a turn: URDF wants radians"));
}

// --- Numbers that are none. -----------------------------------------------------------------------

struct BadNumber {
  const char* name;
  std::string in_joint;
  std::string message;  // behind "a.urdf: joint 'j': "
};

class UrdfNumber : public testing::TestWithParam<BadNumber> {};

TEST_P(UrdfNumber, IsRefusedWithElementAndValue) {
  const auto document = ReadUrdfDocument(
      RobotXml(LinkXml("a") + LinkXml("b") + JointXml("j", "continuous", "a", "b", GetParam().in_joint)),
      "a.urdf");
  ASSERT_FALSE(document.ok());
  EXPECT_EQ(document.status().message(), "a.urdf: joint 'j': " + GetParam().message);
}

INSTANTIATE_TEST_SUITE_P(
    Each, UrdfNumber,
    testing::ValuesIn(std::vector<BadNumber>{
        {"DecimalComma", R"(<dynamics damping="1,5"/>)",
         "<dynamics damping>: '1,5' is not a number (blanks stand between numbers, a point before decimals)"},
        {"Commas", R"(<origin xyz="1, 2, 3"/>)",
         "<origin xyz>: '1, 2, 3' is not 3 numbers (blanks stand between numbers, a point before decimals)"},
        {"Hexadecimal", R"(<dynamics damping="0x10"/>)", "<dynamics damping>: '0x10' is not a number"},
        {"Empty", R"(<dynamics damping=""/>)", "<dynamics damping>: '' is empty"},
        {"Unit", R"(<limit effort="3 Nm" velocity="1"/>)", "<limit effort>: '3 Nm' is not a number"},
        {"TwoForOne", R"(<limit effort="3 4" velocity="1"/>)", "<limit effort>: '3 4' is not a number"},
        {"FourForThree", R"(<origin xyz="1 2 3 4"/>)", "<origin xyz>: '1 2 3 4' is not 3 numbers"},
        {"TwoForThree", R"(<axis xyz="0 1"/>)", "<axis xyz>: '0 1' is not 3 numbers"},
        {"OutOfRange", R"(<origin xyz="0 0 1e999"/>)",
         "<origin xyz>: '0 0 1e999' is out of a double's range"},
        {"NaN", R"(<origin rpy="0 nan 0"/>)", "<origin rpy>: '0 nan 0' is not finite"},
        {"Infinite", R"(<limit effort="inf" velocity="1"/>)", "<limit effort>: 'inf' is not finite"},
        {"MimicFactor", R"(<mimic joint="j" multiplier="half"/>)",
         "<mimic multiplier>: 'half' is not a number"},
        {"MimicWithoutDriver", R"(<mimic multiplier="1"/>)", "<mimic joint> is missing"},
        {"MimicTwice", R"(<mimic joint="j"/><mimic joint="j"/>)", "<mimic> is there twice"},
        {"NegativeVelocity", R"(<limit effort="1" velocity="-1"/>)", "<limit velocity>: '-1' is negative"},
        {"ShortQuaternion", R"(<origin quat_xyzw="0 0 1"/>)", "<origin quat_xyzw>: '0 0 1' is not 4 numbers"},
        {"LongQuaternion", R"(<origin quat_xyzw="0 0 1 1"/>)",
         "<origin quat_xyzw>: '0 0 1 1' is not of length 1"},
        {"TwoRotations", R"(<origin rpy="0 0 0" quat_xyzw="0 0 0 1"/>)",
         "<origin> has both rpy and quat_xyzw"},
        {"NewlineInTheValue", "<dynamics damping=\"a\nb\"/>", "<dynamics damping>: 'a b' is not a number"},
    }),
    [](const auto& info) { return std::string(info.param.name); });

// --- urdfdom as an oracle, which reads plainly spelled numbers right. -------------------------------

void ExpectOrigin(const Pose& ours, const urdf::Pose& theirs, const std::string& where) {
  const Eigen::Vector3d p(theirs.position.x, theirs.position.y, theirs.position.z);
  const urdf::Rotation& r = theirs.rotation;
  EXPECT_EQ(ours.translation, p) << where;
  EXPECT_NEAR((ours.rotation - Eigen::Quaterniond(r.w, r.x, r.y, r.z).toRotationMatrix()).norm(), 0.0, 1e-14)
      << where;
}

void ExpectLink(const UrdfLink& ours, const urdf::Link& theirs) {
  ASSERT_EQ(ours.inertial.has_value(), theirs.inertial != nullptr) << ours.name;
  if (!ours.inertial) return;
  ExpectOrigin(ours.inertial->origin, theirs.inertial->origin, ours.name);
  const urdf::Inertial& i = *theirs.inertial;
  Eigen::Matrix3d inertia;
  inertia << i.ixx, i.ixy, i.ixz, i.ixy, i.iyy, i.iyz, i.ixz, i.iyz, i.izz;
  EXPECT_EQ(ours.inertial->inertia, inertia) << ours.name;
  EXPECT_EQ(ours.inertial->mass, i.mass) << ours.name;
}

void ExpectJoint(const UrdfJoint& ours, const urdf::Joint& theirs) {
  ExpectOrigin(ours.origin, theirs.parent_to_joint_origin_transform, ours.name);
  ASSERT_EQ(ours.is_fixed, theirs.type == urdf::Joint::FIXED);
  if (ours.is_fixed) return;
  const Eigen::Vector3d axis(theirs.axis.x, theirs.axis.y, theirs.axis.z);
  EXPECT_NEAR((ours.axis - axis.normalized()).norm(), 0.0, 1e-15) << ours.name;
  EXPECT_EQ(ours.type == JointType::kPrismatic, theirs.type == urdf::Joint::PRISMATIC);
  EXPECT_EQ(ours.type == JointType::kContinuous, theirs.type == urdf::Joint::CONTINUOUS);
  ASSERT_EQ(ours.effort.has_value(), theirs.limits != nullptr) << ours.name;
  if (theirs.limits != nullptr) {
    EXPECT_EQ(ours.lower, theirs.limits->lower) << ours.name;
    EXPECT_EQ(ours.upper, theirs.limits->upper) << ours.name;
    EXPECT_EQ(*ours.effort, theirs.limits->effort) << ours.name;
    EXPECT_EQ(*ours.velocity, theirs.limits->velocity) << ours.name;
  }
  EXPECT_EQ(ours.damping, theirs.dynamics != nullptr ? theirs.dynamics->damping : 0.0) << ours.name;
  EXPECT_EQ(ours.friction, theirs.dynamics != nullptr ? theirs.dynamics->friction : 0.0) << ours.name;
  ASSERT_EQ(ours.mimic.has_value(), theirs.mimic != nullptr) << ours.name;
  if (!ours.mimic) return;
  EXPECT_EQ(ours.mimic->driver, theirs.mimic->joint_name);
  EXPECT_EQ(ours.mimic->multiplier, theirs.mimic->multiplier);
  EXPECT_EQ(ours.mimic->offset, theirs.mimic->offset);
}

void ExpectWhatUrdfdomReads(const UrdfDocument& ours, const std::string& plain_text) {
  const auto theirs = urdf::parseURDF(plain_text);
  ASSERT_NE(theirs, nullptr) << plain_text;
  ASSERT_EQ(ours.links.size(), theirs->links_.size());
  ASSERT_EQ(ours.joints.size(), theirs->joints_.size());
  EXPECT_EQ(ours.links[ours.root].name, theirs->getRoot()->name);
  for (const UrdfLink& link : ours.links) ExpectLink(link, *theirs->links_.at(link.name));
  for (const UrdfJoint& joint : ours.joints) {
    const urdf::Joint& other = *theirs->joints_.at(joint.name);
    EXPECT_EQ(ours.links[joint.parent].name, other.parent_link_name);
    EXPECT_EQ(ours.links[joint.child].name, other.child_link_name);
    ExpectJoint(joint, other);
  }
}

TEST(UrdfDocument, HoldsWhatUrdfdomReadsOfTheShippedRobots) {
  for (const char* name : {"mico2.urdf", "arm2.urdf", "pendulum.urdf", "arm7.urdf", "slide.urdf"}) {
    const std::string text = ReadFile(std::string("deploy/robots/") + name).value();
    ExpectWhatUrdfdomReads(Read(text), text);
  }
}

TEST(UrdfDocument, HoldsOfOddlySpelledRobotsWhatUrdfdomReadsOfPlainOnes) {
  int links = 0, mimics = 0;
  for (uint64_t seed = 0; seed < 300; ++seed) {
    const std::string plain = testing_support::RandomUrdf(Rng(seed), false).Text();
    const std::string odd = testing_support::RandomUrdf(Rng(seed), true).Text();
    ASSERT_NE(plain, odd);
    const UrdfDocument document = Read(odd);
    ExpectWhatUrdfdomReads(document, plain);
    ASSERT_FALSE(testing::Test::HasFailure()) << "seed " << seed << "\n" << odd;
    for (const UrdfLink& link : document.links) links += link.inertial.has_value();
    for (const UrdfJoint& joint : document.joints) mimics += joint.mimic.has_value();
  }
  EXPECT_GT(links, 1000);
  EXPECT_GT(mimics, 100);
}

}  // namespace
}  // namespace rg::model
