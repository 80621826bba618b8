// URDF text to RobotModel, through urdfdom, strict about what it cannot represent.
//
// urdfdom accepts or drops some things silently (a second element of the same name, unknown
// attributes, text after a number, a zero axis), so the document is examined first and refused in one
// line that names the source, the element and the value:
//   "arm.urdf: joint 'elbow': type 'floating' is not supported (revolute, continuous, prismatic, fixed)"
// Refused: floating and planar joints, mimic joints (unless locked), loops and links with two parents,
// several roots, duplicate names, numbers that are not finite, negative mass, a zero axis, a revolute
// or prismatic joint without limits, moving bodies that nothing gives inertia, more than kMaxBodies
// moving joints. Doubtful but representable values become RobotModel::warnings().
// Visuals, collisions, sensors, transmissions and materials are ignored.
#pragma once

#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.h"
#include "common/model/robot_model.h"

namespace rg::model {

struct LoadOptions {
  // Joints that move. Empty: all revolute, continuous and prismatic joints that are not in `locked`.
  // The rest are locked at their `locked` value, or at 0. The order here does not matter.
  std::vector<std::string> joints;
  // Position at which a joint is locked [rad or m].
  std::map<std::string, double> locked;
  // Link that tasks are stated for; empty: see RobotModel::end_effector.
  std::string end_effector;
};

Result<RobotModel> LoadUrdf(const std::string& path, const LoadOptions& options = {});
// `source_name` stands in messages where a file name would.
Result<RobotModel> ParseUrdf(const std::string& xml, const std::string& source_name,
                             const LoadOptions& options = {});

}  // namespace rg::model
