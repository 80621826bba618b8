// A second look: every number of the finished model beside the text it was made from.
#pragma once

#include <string>

#include "common/base/status.h"
#include "common/model/robot_model.h"

namespace rg::model {

// Goes through model.urdf_text() anew, without the loader's data, and compares all that the model
// holds of it: which links have an inertial, masses, centres of mass, inertias, the pose of every child
// link in its parent (standing joints at model.locked() or where their mimic has them), axes, limits,
// dynamics, followers with their driver, multiplier and offset. Internal error naming link or joint,
// attribute and both values of the first that differs, which is a bug of this program.
Status CompareWithDocument(const RobotModel& model, const std::string& source_name);

}  // namespace rg::model
