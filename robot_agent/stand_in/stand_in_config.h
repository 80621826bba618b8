// What the stand-in hides and how it fails: realitygrad.stand_in/1, JSON, never read by the agent.
//
//   "format", "robot_type" ("m1n6s200"), "robot_name" (default: the type)
//   "truth"                realitygrad.robot_truth/1, relative to this file: arm, drives, sensors, the masses
//   that
//                          its gravity compensation believes
//   "call_s"               what one call of the arm's interface takes (0.0028); a tick makes nine
//   "jitter_s"             a tick begins up to this much late (0.004)
//   "lost_at_start_s"      torques of the first time after the first one are lost (0.3)
//   "sensor_offset_nm"     [n] what the torque sensors read wrong until they are zeroed
//   "switch_threshold_nm"  torque mode is refused, without a word, when a measured torque is further than
//   this from
//                          the base's gravity and the command (2)
//   "limit_distance_deg"   nearer than this to a stop the base falls back to position mode (5)
//   "turns"                [n] how many turns the arm's angles are ahead of the model's
//   "torque_sign"          [n] 1; -1: a sign is wrong; 0: a joint is dead
//   "refuse_torque_mode"   so many times more than its reasons ask for; -1: always (0)
//   "leave_torque_mode_s"  after this long in torque mode the base falls back to position mode (0: not)
//   "outage_after_s"       after this long in torque mode an error of the interface ends everything (0: not),
//   for "outage_s"             (1.3), once "outages_per_s"        the same at random, at this rate, in any
//   mode (0)
// Unknown fields are refused.
#pragma once

#include <string>
#include <vector>

#include "common/base/status.h"

namespace rg::robot_agent::stand_in {

struct StandInConfig {
  std::string robot_type = "m1n6s200", robot_name;
  std::string truth_path;
  double call_s = 0.0028, jitter_s = 0.004, lost_at_start_s = 0.3;
  std::vector<double> sensor_offset_nm;
  double switch_threshold_nm = 2.0, limit_distance_deg = 5.0;
  std::vector<int> turns;
  std::vector<double> torque_sign;
  int refuse_torque_mode = 0;
  double leave_torque_mode_s = 0.0, outage_after_s = 0.0, outage_s = 1.3, outages_per_s = 0.0;
};

Result<StandInConfig> LoadStandInConfig(const std::string& path);

}  // namespace rg::robot_agent::stand_in
