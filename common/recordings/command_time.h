// When commands took effect.
#pragma once

#include <Eigen/Core>

#include "common/recordings/recording.h"

namespace rg::recordings {

// The column of Recording::other that says when a row's command was sent [s, as the column time]: a
// controller needs a while to answer the state that a row holds, and until then the command before is in
// force.
inline constexpr const char* kCommandTime = "command_time";

// K, increasing: that column where all of it is at or after its row and before the next but one; else the
// rows' own times.
const Eigen::VectorXd& CommandTimes(const Recording& recording);

// Whether no joint moves in the first row: |v| within three stddevs of the velocities' noise. Without
// measured velocities nothing says that one does.
bool StartsAtRest(const Recording& recording);

// When motion begins [s]: a robot that rests in the first row stays where it is until the first command, whatever a
// model says of what held it. Else the first row's time.
double MotionBegin(const Recording& recording);

}  // namespace rg::recordings
