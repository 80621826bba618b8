// What a kinova-ros of the laboratory compares before it talks to us: the type's name and its md5 sum.
#include <gtest/gtest.h>
#include <kinova_msgs/ArmJointAnglesActionGoal.h>
#include <kinova_msgs/ClearTrajectories.h>
#include <kinova_msgs/HomeArm.h>
#include <kinova_msgs/JointAngles.h>
#include <kinova_msgs/JointTorque.h>
#include <kinova_msgs/JointVelocity.h>
#include <kinova_msgs/RunCOMParametersEstimation.h>
#include <kinova_msgs/SetEndEffectorOffset.h>
#include <kinova_msgs/SetTorqueControlMode.h>
#include <kinova_msgs/SetTorqueControlParameters.h>
#include <kinova_msgs/Start.h>
#include <kinova_msgs/Stop.h>
#include <kinova_msgs/ZeroTorques.h>
#include <sensor_msgs/JointState.h>

#include <string>

namespace rg {
namespace {

namespace traits = ros::service_traits;

template <class M>
std::string Sum() {
  return ros::message_traits::MD5Sum<M>::value();
}
template <class M>
std::string Name() {
  return ros::message_traits::DataType<M>::value();
}
template <class S>
std::string ServiceSum() {
  return traits::MD5Sum<S>::value();
}

TEST(KinovaMessages, HaveTheMd5SumsOfKinovaRos) {
  EXPECT_EQ(Sum<kinova_msgs::JointTorque>(), "bf16c4e5154848a0767d1aaab0a4796b");
  EXPECT_EQ(Sum<kinova_msgs::JointAngles>(), "bf16c4e5154848a0767d1aaab0a4796b");
  EXPECT_EQ(Sum<kinova_msgs::JointVelocity>(), "bf16c4e5154848a0767d1aaab0a4796b");
  EXPECT_EQ(Sum<kinova_msgs::ArmJointAnglesActionGoal>(), "c55abb1cfa18bfc551ab65ebef8ed3a9");
  EXPECT_EQ(Sum<sensor_msgs::JointState>(), "3066dcd76a6cfaef579bd0f34173e9fd");
}

TEST(KinovaServices, HaveTheMd5SumsOfKinovaRos) {
  EXPECT_EQ(ServiceSum<kinova_msgs::SetTorqueControlMode>(), "891b541ef99af7889d0f22a062410be8");
  const std::string result = "c22f2a1ed8654a0b365f1bb3f7ff2c0f";
  EXPECT_EQ(ServiceSum<kinova_msgs::ZeroTorques>(), result);
  EXPECT_EQ(ServiceSum<kinova_msgs::SetTorqueControlParameters>(), result);
  EXPECT_EQ(ServiceSum<kinova_msgs::RunCOMParametersEstimation>(), result);
  EXPECT_EQ(ServiceSum<kinova_msgs::ClearTrajectories>(), result);
  EXPECT_EQ(ServiceSum<kinova_msgs::Start>(), "e762e31d813526eaaa6a12e8354174fc");
  EXPECT_EQ(ServiceSum<kinova_msgs::Stop>(), "585dc4164508d473dff8f8b67a05d2ad");
  EXPECT_EQ(ServiceSum<kinova_msgs::HomeArm>(), "46e470f2c1a7177398c57a43eafe8d67");
  EXPECT_EQ(ServiceSum<kinova_msgs::SetEndEffectorOffset>(), "7a5c04366489f137e01b31118dcce900");
}

// roscpp refuses a peer whose type has another package, even with the right sum.
TEST(KinovaMessages, BelongToThePackageOfKinovaRos) {
  EXPECT_EQ(Name<kinova_msgs::JointTorque>(), "kinova_msgs/JointTorque");
  EXPECT_EQ(Name<kinova_msgs::ArmJointAnglesActionGoal>(), "kinova_msgs/ArmJointAnglesActionGoal");
  EXPECT_STREQ(traits::DataType<kinova_msgs::SetTorqueControlMode>::value(),
               "kinova_msgs/SetTorqueControlMode");
}

}  // namespace
}  // namespace rg
