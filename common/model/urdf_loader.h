// URDF text to RobotModel, strict about what it cannot represent, and silent about nothing.
//
// All numbers come from this program's own reader of the document (urdf_document.h), in every locale;
// the finished model is compared with the document once more, number by number (urdf_comparison.h).
// What is refused is refused in one line that names the source, the element and the value:
//   "arm.urdf: joint 'elbow': type 'floating' is not supported (revolute, continuous, prismatic, fixed)"
// Refused: what ReadUrdfDocument refuses (no URDF at all, xacro, floating and planar joints, loops,
// several roots, duplicate names, numbers that are none or not finite, negative masses, a zero axis,
// missing limits), more than kMaxBodies moving bodies, a robot none of whose moving links has mass.
// RobotModel::warnings() holds one line for each thing that is not read (urdf_leftovers.h) or doubtful.
// Visuals, collisions, sensors, transmissions and materials are ignored.
//
// Mimic joints follow their drivers, through chains of mimics to a joint that is none:
//   driver moves            the mimic is one of RobotModel::followers(), also where `joints` names only
//                           the driver; where it names both, a warning says that the mimic follows
//   driver stands at q      the mimic stands at multiplier · q + offset, and a warning says so
//   mimic itself in `locked`  stands there; a warning says so where the driver would have it elsewhere
// Refused: a driver that does not exist, a ring of mimics, a mimic in `joints` whose driver stands.
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
  // The rest, but for mimics, are locked at their `locked` value, or at 0. The order does not matter.
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
