// One joint_state message of kinova-ros, picked by names and judged.
//
// The message holds the arm's joints and its fingers (m1n6s200_joint_1 … _joint_finger_tip_2), whose
// number depends on the model of the arm: joints are found by name, the others are left out.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "robot_agent/drivers/driver.h"

namespace rg::robot_agent::kinova {

struct JointReport {
  int64_t stamp_ns = 0;     // the robot's clock
  int64_t received_ns = 0;  // host's steady clock
  uint32_t number = 0;      // the publisher's, grows by one with every message
  JointArray q{};           // rad, as the arm counts them: turns are in it
  JointArray v{};           // rad/s
  JointArray effort{};      // N·m
};

// A message's arrays as they came; all of the same length.
struct RawJointState {
  const std::vector<std::string>& names;
  const std::vector<double>& position;
  const std::vector<double>& velocity;
  const std::vector<double>& effort;
};

// "m1n6s200" -> 6; kInvalid naming what such a name looks like. The letters: model (j, m), its number, n,
// joints, wrist (s: service …), fingers.
Result<int> JointsOfType(const std::string& robot_type);
// {"m1n6s200_joint_1", …}
std::vector<std::string> RosJointNames(const std::string& prefix, int joints);

// The values of `wanted` (at most kMaxJoints names) into q, v, effort. kInvalid: one is missing, twice
// there, or the arrays differ in length.
Status PickJoints(const RawJointState& raw, const std::vector<std::string>& wanted, JointReport* report);

// What an arm at work cannot say: NaN, angles of more than ten turns, speeds of more than 20 rad/s, torques
// of more than 100 N·m; and efforts that are all exactly zero, as from an arm that is not in service mode.
// The message names joint, value, limit and remedy.
Status CheckPlausible(const JointReport& report, const std::vector<std::string>& names);

}  // namespace rg::robot_agent::kinova
