#include "robot_agent/drivers/kinova/joint_report.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "common/base/printf.h"

namespace rg::robot_agent::kinova {
namespace {

constexpr double kMostAngle = 20.0 * std::numbers::pi;
constexpr double kMostSpeed = 20.0;
constexpr double kMostEffort = 100.0;

Status CheckSize(const char* what, size_t have, size_t want) {
  if (have == want) return Status::Ok();
  return InvalidError("joint_state has " + std::to_string(want) + " names and " + std::to_string(have) + " " +
                      what);
}

Status CheckValue(const std::string& joint, const char* what, double value, double limit) {
  if (std::isfinite(value) && std::abs(value) <= limit) return Status::Ok();
  const std::string text = Printf(": %s %.4g, an arm at work has at most %.4g", what, value, limit);
  return InvalidError(joint + text);
}

}  // namespace

Result<int> JointsOfType(const std::string& type) {
  const bool shaped = type.size() == 8 && (type[0] == 'j' || type[0] == 'm') && std::isdigit(type[1]) &&
                      (type[2] == 'n' || type[2] == 's') && std::isdigit(type[3]) && std::isalpha(type[4]) &&
                      std::isdigit(type[5]);
  const int joints = shaped ? type[3] - '0' : 0;
  if (joints >= 4 && joints <= 7) return joints;
  return InvalidError("robot_type is \"" + type +
                      "\", needs a name of kinova-ros such as m1n6s200, j2n6s300 or j2n7s300");
}

std::vector<std::string> RosJointNames(const std::string& prefix, int joints) {
  std::vector<std::string> names;
  for (int i = 1; i <= joints; ++i) names.push_back(prefix + "_joint_" + std::to_string(i));
  return names;
}

Status PickJoints(const RawJointState& raw, const std::vector<std::string>& wanted, JointReport* report) {
  RG_RETURN_IF_ERROR(CheckSize("positions", raw.position.size(), raw.names.size()));
  RG_RETURN_IF_ERROR(CheckSize("velocities", raw.velocity.size(), raw.names.size()));
  RG_RETURN_IF_ERROR(CheckSize("efforts", raw.effort.size(), raw.names.size()));
  for (size_t i = 0; i < wanted.size(); ++i) {
    const auto found = std::find(raw.names.begin(), raw.names.end(), wanted[i]);
    if (found == raw.names.end()) return InvalidError("joint_state does not have the joint " + wanted[i]);
    if (std::find(found + 1, raw.names.end(), wanted[i]) != raw.names.end())
      return InvalidError("joint_state has the joint " + wanted[i] + " twice");
    const auto at = found - raw.names.begin();
    report->q[i] = raw.position[at];
    report->v[i] = raw.velocity[at];
    report->effort[i] = raw.effort[at];
  }
  return Status::Ok();
}

Status CheckPlausible(const JointReport& report, const std::vector<std::string>& names) {
  bool all_zero = true;
  for (size_t i = 0; i < names.size(); ++i) {
    RG_RETURN_IF_ERROR(CheckValue(names[i], "position (rad)", report.q[i], kMostAngle));
    RG_RETURN_IF_ERROR(CheckValue(names[i], "velocity (rad/s)", report.v[i], kMostSpeed));
    RG_RETURN_IF_ERROR(CheckValue(names[i], "effort (N·m)", report.effort[i], kMostEffort));
    all_zero = all_zero && report.effort[i] == 0.0;
  }
  if (!all_zero) return Status::Ok();
  return FailedPreconditionError(
      "every measured torque is exactly 0: the arm is not in service mode (KinovaDevelopmentCenter, or an "
      "arm that is off)");
}

}  // namespace rg::robot_agent::kinova
