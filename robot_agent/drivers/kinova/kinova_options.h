// What the driver `kinova` has to know of one arm: the object "kinova" of the agent's configuration.
//
// All fields may be left out for a Mico² whose driver runs on this machine:
//   "robot_type"           as for kinova_bringup: "m1n6s200" (default), "j2n6s300", "j2n7s300", …
//   "robot_name"           the prefix of its topics; default: the type
//   "master"               "http://HOST:11311"; default: the environment's ROS_MASTER_URI
//   "stop_topic"           of std_msgs/Empty: whatever is published there stops the arm ("/realitygrad/stop")
//   "joints"               the model's names of the arm's joints in their order; default: joint_1, joint_2, …
//   "zero_pose_deg"        where gravity does not load the torque sensors; default: Mico² [0, 180, 180, 0, 0, 0]
//   "zero_limit_nm"        what a sensor may still read there once it is zeroed (1)
//   "test_torque_nm"       per joint, the most of the test torque, above gravity; Mico²: [2, 4, 2, 1, 1, 1]
//   "test_motion_rad"      the motion that counts as an answer (0.02)
//   "prepare_every_s"      after this long sensors are zeroed and all torques tested again (1800; 0: each time)
//   "least_rate_hz"        of states (20)
//   "outage_s"             no state for this long: the arm is lost (1)
//   "command_timeout_s"    no command of the controller for this long: zero added torque is sent (0.12)
//   "service_timeout_s"    what a service may take (3, the most: a stop asks two, after two others, see kLongestCall)
//   "farewell_s"           how long the end of a rollout waits for an arm that is away, to put it into position
//                          mode (10)
//   "torque_mode_attempts" how often torque mode is asked for before the refusal is believed (3)
#pragma once

#include <string>
#include <vector>

#include "common/base/status.h"

namespace rg::robot_agent::kinova {

inline constexpr double kWantedRateHz = 25.0;
inline constexpr double kCommandRateHz = 100.0;  // what the arm's base wants torques at

struct KinovaOptions {
  std::string robot;  // the agent's name of it
  std::string robot_type = "m1n6s200";
  std::string robot_name;  // filled in
  std::string master_uri;  // empty: the environment's
  std::string stop_topic = "/realitygrad/stop";
  std::vector<std::string> joints;
  std::vector<bool> continuous;  // by the type
  std::vector<double> zero_pose_deg, test_torque_nm;
  double zero_limit_nm = 1.0;
  double test_motion_rad = 0.02;
  double least_rate_hz = 20.0;
  double outage_s = 1.0;
  double command_timeout_s = 0.12;
  double service_timeout_s = 3.0;
  double farewell_s = 10.0;
  int torque_mode_attempts = 3;
  double prepare_every_s = 1800.0;
  std::string session_path;  // the agent's: where a preparation is kept (arm_session.h); empty: nowhere

  int n() const { return static_cast<int>(joints.size()); }
};

// `json`: the object's text; errors name field, value and limit.
Result<KinovaOptions> ParseKinovaOptions(const std::string& json, const std::string& robot);

}  // namespace rg::robot_agent::kinova
