// The boxes a rollout has to stay in. Checked once when configured, trusted afterwards.
#pragma once

#include <string>
#include <vector>

#include "common/base/status.h"

namespace rg::robot_agent {

struct TaskBox {
  bool enabled = false;
  double lower[3] = {-1e9, -1e9, -1e9};  // m, base frame, origin of the end-effector frame
  double upper[3] = {1e9, 1e9, 1e9};
};

struct SafetyLimits {
  std::vector<double> lower, upper;  // n, measured position, rad (m)
  std::vector<double> velocity;      // n, |measured velocity|, rad/s (m/s)
  // n, N·m (N). Commands are limited to ±torque before they are sent (each limited sample is counted
  // and reported); one beyond torque_trip_ratio · torque is no saturation but a fault, and stops.
  std::vector<double> torque;
  double torque_trip_ratio = 3.0;  // ≥ 1
  TaskBox task;
  double stale_s = 0.12;  // oldest state a command may be computed from
  // Two measurements dt apart may differ by jump_ratio · velocity · dt + jump_tolerance.
  double jump_ratio = 2.0;         // ≥ 1
  double jump_tolerance = 0.02;    // rad (m)
  int max_consecutive_missed = 4;  // deadlines missed in a row before the stop, ≥ 1
  double max_missed_share = 0.2;   // of all ticks so far, after the first second
  double zero_torque_s = 0.12;     // zero added torque for this long, then position mode; ≥ 0
};

// kInvalid naming the field, joint, value and limit. `start` (n, may be empty): the pose rollouts
// start from, which has to lie inside the position box.
Status ValidateLimits(const SafetyLimits& limits, const std::vector<std::string>& joints,
                      const std::vector<double>& start);

// {"lower": [...], "upper": [...], "velocity": [...], "torque": [...], "task_box": {"lower": [3],
// "upper": [3]}, "stale_s", "jump_ratio", "jump_tolerance", "torque_trip_ratio",
// "max_consecutive_missed", "max_missed_share", "zero_torque_s"}; unknown fields are refused. What is
// absent keeps its value in `defaults` (for the vectors: what the model says).
Result<SafetyLimits> ParseLimits(const std::string& json, const SafetyLimits& defaults,
                                 const std::string& source);
std::string LimitsToJson(const SafetyLimits& limits);

}  // namespace rg::robot_agent
