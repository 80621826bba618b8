// Which joints of a robot meet no inertia, so that their rotors must have some.
#pragma once

#include <vector>

#include "common/model/robot_model.h"

namespace rg::model {

// The pivots of the mass matrix M(q) (n × n, followers moving with their drivers), taken from the last
// joint to the first, are the inertias that the joints' torques meet while all joints after them are
// free. Indices, ascending, of the joints whose pivot is 0 to rounding at each of a few generic poses:
// M + diag(r) is positive definite for every r > 0 on them and r = 0 elsewhere. Uses
// `parts.joints`, `followers` and `links`.
std::vector<int> JointsWithoutInertia(const RobotModel::Parts& parts);

}  // namespace rg::model
