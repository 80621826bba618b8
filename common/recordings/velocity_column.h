// Velocity columns that a driver never fills, or stops filling.
#pragma once

#include "common/recordings/recording.h"

namespace rg::recordings {

// Leaves measured velocities out (v becomes 0 × 0, a note names the joint) where a joint's column is zero, or
// repeats one value, in more than a tenth of the time in which its positions clearly move at another speed.
// Coarse steps of a velocity sensor are no standstill.
void LeaveOutFrozenVelocity(Recording* recording);

}  // namespace rg::recordings
