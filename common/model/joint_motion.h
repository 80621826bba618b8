// Which joints of a URDF move, which follow others, and where the rest stand. Internal to the loader.
#pragma once

#include <string>
#include <vector>

#include "common/base/status.h"
#include "common/model/urdf_document.h"
#include "common/model/urdf_loader.h"

namespace rg::model {

struct JointMotion {
  enum class Kind { kStands, kMoves, kFollows };
  Kind kind = Kind::kStands;
  double position = 0.0;  // kStands [rad or m]
  // kFollows: q = multiplier · q_driver + offset, the driver being an index into the document's joints
  // that moves; multiplier is not 0.
  int driver = -1;
  double multiplier = 1.0;
  double offset = 0.0;
};

// One for each joint of the document, as urdf_loader.h says. Appends what is to be said of mimics to
// `warnings`.
Result<std::vector<JointMotion>> MotionOfJoints(const UrdfDocument& document, const std::string& source_name,
                                                const LoadOptions& options,
                                                std::vector<std::string>* warnings);

}  // namespace rg::model
