// Angles that an encoder wraps: 3.14, -3.14 one row later.
#pragma once

#include <vector>

#include "common/base/status.h"
#include "common/recordings/joint_info.h"
#include "common/recordings/recording.h"

namespace rg::recordings {

// Unwraps positions of continuous joints that jump by a full turn, and of revolute joints if the unwrapped
// motion lies within their limits. q changes, turns_added says
// by what, a note is added. The first row's angle stays as it is, unless only another turn keeps a
// revolute joint within its limits.
//
// A step from row to row is a jump where it is more than 1 rad, and more than 200 rad/s² would make, from
// what the steps beside it say. Across more than 0.1 s nothing is called a jump. Error: a jump that is no
// turn (file, row, column, values). Joints without an entry in `robot` are not looked at.
Status UnwrapAngles(const std::vector<JointInfo>& robot, Recording* recording);

// Positions n × K of the recording's rows in the wrapping of its file: the turns that were added there are
// taken off again.
Eigen::MatrixXd InFilesWrapping(const Recording& recording, Eigen::MatrixXd q);

}  // namespace rg::recordings
