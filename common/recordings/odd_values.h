// Values that no robot's sensors and drives give, whatever its units.
#pragma once

#include "common/base/status.h"
#include "common/recordings/recording.h"

namespace rg::recordings {

// Refuses, by row and column, a single effort a thousand times what the others are and above 1000 (N m or N),
// a single velocity a hundred times what the others are and above 50 (rad/s or m/s), and positions that stand
// still for 0.4 s or more in which the measured velocity says that the joint moves.
Status CheckOddValues(const Recording& recording);

}  // namespace rg::recordings
