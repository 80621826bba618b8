// First look at a URDF text: what urdfdom would accept or drop silently is refused here by name.
// Internal to the loader.
#pragma once

#include <string>
#include <vector>

#include "common/base/status.h"

namespace rg::model {

// The order of the document, which urdfdom's maps lose.
struct UrdfOutline {
  std::string robot_name;
  std::vector<std::string> links;
  std::vector<std::string> joints;
};

// Well-formed XML with one <robot>; unique names; joints of a supported type between links that
// exist, making one tree; finite numbers; no negative masses; axes that are not zero; limits where
// they are required. Messages name `source_name`, the element and the value.
Result<UrdfOutline> CheckUrdfDocument(const std::string& xml, const std::string& source_name);

}  // namespace rg::model
