#include "common/model/urdf_leftovers.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/model/urdf_loader.h"
#include "tests/support/model/urdf_text.h"

namespace rg::model {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;
using testing_support::JointXml;
using testing_support::kUnitInertial;
using testing_support::LinkXml;
using testing_support::RobotXml;

std::vector<std::string> Leftovers(const std::string& xml) {
  TiXmlDocument document;
  document.Parse(xml.c_str());
  RG_CHECK(!document.Error()) << document.ErrorDesc();
  return UrdfLeftovers(*document.RootElement(), "a.urdf");
}
std::vector<std::string> OfJoint(const std::string& inside, const std::string& type = "revolute") {
  return Leftovers(RobotXml(JointXml("elbow", type, "a", "b", inside)));
}
std::vector<std::string> OfLink(const std::string& inside) {
  return Leftovers(RobotXml(LinkXml("arm", inside)));
}

TEST(UrdfLeftovers, UnknownAttributesAreSaidOneByOne) {
  EXPECT_THAT(OfJoint(R"(<dynamics damping="1" stiction="2" armature="3"/>)"),
              ElementsAre("a.urdf: joint 'elbow': <dynamics stiction> is not read",
                          "a.urdf: joint 'elbow': <dynamics armature> is not read"));
  EXPECT_THAT(OfJoint(R"(<limit lower="0" upper="1" effort="1" velocity="1" acceleration="5"/>)"),
              ElementsAre("a.urdf: joint 'elbow': <limit acceleration> is not read"));
  EXPECT_THAT(OfJoint(R"(<axis xyz="1 0 0" rpy="0 0 1"/><origin xyz="0 0 0" frame="a"/>)"),
              ElementsAre("a.urdf: joint 'elbow': <axis rpy> is not read",
                          "a.urdf: joint 'elbow': <origin frame> is not read"));
  EXPECT_THAT(OfJoint(R"(<mimic joint="j" multiplyer="2"/>)"),
              ElementsAre("a.urdf: joint 'elbow': <mimic multiplyer> is not read"));
  EXPECT_THAT(OfLink(R"(<inertial><mass value="1" unit="g"/><inertia ixx="1" iyx="3"/></inertial>)"),
              ElementsAre("a.urdf: link 'arm': <mass unit> is not read",
                          "a.urdf: link 'arm': <inertia iyx> is not read"));
  EXPECT_THAT(Leftovers(R"(<robot name="r"><link name="a" mass="2"/><joint name="j" offset="1"/></robot>)"),
              ElementsAre("a.urdf: link 'a': <link mass> is not read",
                          "a.urdf: joint 'j': <joint offset> is not read"));
}

TEST(UrdfLeftovers, UnknownElementsAreSaidWithWhatTheyHold) {
  EXPECT_THAT(
      OfJoint(R"(<safety_controller soft_lower_limit="-2" k_velocity="10"/><calibration rising="0"/>)"),
      ElementsAre("a.urdf: joint 'elbow': <safety_controller soft_lower_limit k_velocity> is not read",
                  "a.urdf: joint 'elbow': <calibration rising> is not read"));
  EXPECT_THAT(OfLink("<intertial/>"), ElementsAre("a.urdf: link 'arm': <intertial> is not read"));
  EXPECT_THAT(OfLink("<inertial><com xyz='0 0 0'/></inertial>"),
              ElementsAre("a.urdf: link 'arm': <com xyz> is not read"));
  EXPECT_THAT(OfJoint(R"(<drake:rotor_inertia value="1e-4"/>)"),
              ElementsAre("a.urdf: joint 'elbow': <drake:rotor_inertia value> is not read"));
  EXPECT_THAT(Leftovers(R"(<robot name="r"><loop_joint name="l" type="revolute"/><Link name="a"/></robot>)"),
              ElementsAre("a.urdf: <loop_joint 'l'> is not read", "a.urdf: <Link 'a'> is not read"));
}

TEST(UrdfLeftovers, ElementsInTheWrongPlaceAreToldWhereTheyBelong) {
  EXPECT_THAT(OfLink(R"(<mass value="1"/><inertia ixx="1"/>)"),
              ElementsAre("a.urdf: link 'arm': <mass value> is not read (it belongs into <inertial>)",
                          "a.urdf: link 'arm': <inertia ixx> is not read (it belongs into <inertial>)"));
  EXPECT_THAT(OfLink(R"(<joint name="k" type="fixed"/>)"),
              ElementsAre("a.urdf: link 'arm': <joint 'k'> is not read (it belongs into <robot>)"));
  EXPECT_THAT(OfJoint(R"(<inertial><mass value="1"/></inertial>)"),
              ElementsAre("a.urdf: joint 'elbow': <inertial> is not read (it belongs into <link>)"));
  EXPECT_THAT(OfLink(R"(<origin xyz="0 0 1"/>)"),
              ElementsAre("a.urdf: link 'arm': <origin xyz> is not read"));
}

TEST(UrdfLeftovers, TextThatShouldBeAnAttributeIsSaid) {
  EXPECT_THAT(OfJoint("<origin>0 0\n1</origin>"),
              ElementsAre("a.urdf: joint 'elbow': <origin>: the text '0 0 1' is not read"));
}

TEST(UrdfLeftovers, NumbersWithoutAMeaningForTheTypeOfJointAreSaid) {
  EXPECT_THAT(
      OfJoint(R"(<limit lower="-6.28" upper="6.28" effort="1" velocity="1"/>)", "continuous"),
      ElementsAre(
          "a.urdf: joint 'elbow': <limit lower> is not used: a continuous joint turns without limits",
          "a.urdf: joint 'elbow': <limit upper> is not used: a continuous joint turns without limits"));
  EXPECT_THAT(OfJoint(R"(<limit lower="0" upper="0.0" effort="1" velocity="1"/>)", "continuous"), IsEmpty());
  EXPECT_THAT(OfJoint(R"(<dynamics damping="3"/><mimic joint="j"/>)", "fixed"),
              ElementsAre("a.urdf: joint 'elbow': <dynamics> is not used: the joint is fixed",
                          "a.urdf: joint 'elbow': <mimic> is not used: the joint is fixed"));
  EXPECT_THAT(OfJoint(R"(<axis xyz="0 0 0"/><limit lower="0" upper="0" effort="0" velocity="0"/>)", "fixed"),
              IsEmpty());
}

TEST(UrdfLeftovers, WhatIsNoneOfADynamicsBusinessIsSilent) {
  EXPECT_THAT(Leftovers(R"(<robot name="r" version="1.0" xmlns:xacro="http://ros.org/wiki/xacro" xmlns="x">
    <!-- comment --><material name="m"><color rgba="1 1 1 1"/></material>
    <transmission name="t"><joint name="j"/><actuator name="a"><mechanicalReduction>100</mechanicalReduction></actuator></transmission>
    <gazebo reference="a"><mu1>0.2</mu1></gazebo><ros2_control name="c" type="system"><hardware/></ros2_control>
    <sensor name="s"/>
    <link name="a"><visual><origin xyz="+1 0 0"/><geometry><box size="x"/></geometry></visual>
      <collision name="c"><geometry/></collision><sensor type="ray"/><gazebo/></link>
    <joint name="j" type="fixed"><gazebo/><!-- ${x} --></joint></robot>)"),
              IsEmpty());
}

TEST(UrdfLeftovers, TheSameLineIsSaidOnce) {
  EXPECT_THAT(OfLink("<note/><note/><note/>"), ElementsAre("a.urdf: link 'arm': <note> is not read"));
}

TEST(UrdfLeftovers, AVersionThatNobodyKnowsIsSaid) {
  EXPECT_THAT(Leftovers(R"(<robot name="r" version="2.0"/>)"),
              ElementsAre("a.urdf: <robot version>: '2.0' is not known; read as version 1"));
  EXPECT_THAT(Leftovers(R"(<robot name="r" version="1.1"/>)"), IsEmpty());
}

TEST(UrdfLeftovers, BecomeTheModelsWarnings) {
  const auto model =
      ParseUrdf(RobotXml(LinkXml("a") + LinkXml("b", std::string(kUnitInertial) + "<inertia ixx='2'/>") +
                         JointXml("j", "continuous", "a", "b", "<dynamics stiction='1'/>")),
                "a.urdf");
  ASSERT_TRUE(model.ok()) << model.status().message();
  EXPECT_THAT(model->warnings(),
              ElementsAre("a.urdf: link 'b': <inertia ixx> is not read (it belongs into <inertial>)",
                          "a.urdf: joint 'j': <dynamics stiction> is not read"));
}

}  // namespace
}  // namespace rg::model
