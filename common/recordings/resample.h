// Recordings at other times than their rows'.
#pragma once

#include <Eigen/Core>

#include "common/recordings/recording.h"

namespace rg::recordings {

// The row whose interval [t[k], t[k+1]) holds `time`; 0 before the first row, K − 1 from the last on.
int RowAt(const Eigen::VectorXd& t, double time);

// x: n × K at the times t, linear between rows, constant outside. Returns n × times.size().
Eigen::MatrixXd InterpolateLinear(const Eigen::VectorXd& t, const Eigen::MatrixXd& x,
                                  const Eigen::VectorXd& times);
// x held from its row's time to the next row's. Returns n × times.size().
Eigen::MatrixXd InterpolateZeroOrder(const Eigen::VectorXd& t, const Eigen::MatrixXd& x,
                                     const Eigen::VectorXd& times);

// The recording at `times` (strictly increasing, within the recording): position, velocity, measured
// effort and other columns linear, commanded effort held.
Recording Resample(const Recording& recording, const Eigen::VectorXd& times);
// The same at a fixed rate from the first row's time to the last's.
Recording ResampleAtRate(const Recording& recording, double rate_hz);

}  // namespace rg::recordings
