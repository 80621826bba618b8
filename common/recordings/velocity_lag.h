// Velocity columns that a drive has filtered: they follow the positions' slope some milliseconds late.
#pragma once

#include <Eigen/Core>

#include "common/recordings/recording.h"

namespace rg::recordings {

struct VelocityLag {
  Eigen::VectorXd lag;     // n, s: velocity(t) ≈ dq/dt(t − lag), least squares; positive where it is late
  Eigen::VectorXd stddev;  // n, s, of the estimate
  // n, rad/s or m/s: RMS error that a lag beyond two stddev makes of the velocity; 0 where none shows.
  Eigen::VectorXd error;
};

// Slopes and curvatures by local cubics of the positions at some hundred rows. All zero where no velocity is
// measured or there are fewer than 30 rows.
VelocityLag EstimateVelocityLag(const Recording& recording);

}  // namespace rg::recordings
