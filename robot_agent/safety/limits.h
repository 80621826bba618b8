// The boxes an arm has to stay in. They come from the agent's own configuration, are checked once when it is
// read and trusted afterwards; what a job brings can make them tighter, never wider.
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
  // n, rad/s (m/s): of velocities that the monitor differences itself, see velocity_window_s.
  std::vector<double> velocity;
  // n, N·m (N). Commands are limited to ±torque before they are sent (each limited sample is counted
  // and reported); one beyond torque_trip_ratio · torque is no saturation but a fault, and stops.
  std::vector<double> torque;
  double torque_trip_ratio = 3.0;  // ≥ 1
  // n, N·m/s (N/s). A command that changes faster is limited to this rate, and counted like one beyond
  // ±torque. The stop (zero added torque) is not held up by it.
  std::vector<double> torque_rate;
  TaskBox task;
  double stale_s = 0.12;  // oldest state a command may be computed from
  // Positions this far apart in time are differenced to velocities (the nearest that is not less), s.
  double velocity_window_s = 0.03;
  // Positions of all joints that stay the same to the last digit while their stamps advance: for so long
  // after a motion, or so long after the arm, at rest, was told to move. ≥ 1e-3.
  double freeze_s = 0.12, freeze_start_s = 1.0;
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

// What every configuration has to say: {"lower": [n], "upper": [n], "velocity": [n], "torque": [n],
// "torque_rate": [n], "task_box": {"lower": [3], "upper": [3]} or null (the end effector may be anywhere)}, a
// missing one is an error with its name. And what it may say: "torque_trip_ratio", "stale_s",
// "velocity_window_s", "freeze_s", "freeze_start_s", "jump_ratio", "jump_tolerance",
// "max_consecutive_missed", "max_missed_share", "zero_torque_s". Unknown fields are refused.
Result<SafetyLimits> ParseLimits(const std::string& json, const std::string& source);
std::string LimitsToJson(const SafetyLimits& limits);

// What a job asks for, n entries each or empty: says nothing.
struct TighterLimits {
  std::vector<double> lower, upper, velocity, torque;
};
// `own` made smaller where `asked` is inside it; never larger anywhere. kInvalid where nothing is left of a
// position box, or an entry is not a number.
Result<SafetyLimits> Tighten(const SafetyLimits& own, const TighterLimits& asked,
                             const std::vector<std::string>& joints);

}  // namespace rg::robot_agent
