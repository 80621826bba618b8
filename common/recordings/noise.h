// What the data sheet does not say: the noise of the positions, their resolution, and the velocity
// where it is not measured. All of it works on irregular sampling.
#pragma once

#include <Eigen/Core>

#include "common/recordings/recording.h"
#include "common/recordings/recording_set.h"

namespace rg::recordings {

struct SignalNoise {
  double stddev = 0.0;      // of the white part, quantisation included
  double resolution = 0.0;  // step of the grid that the values lie on; 0: no grid is visible
};

// Noise of a smooth signal x (K values at times t) from divided differences of order `order`, weighted
// so that each has the variance of the noise and a polynomial of lower degree leaves nothing. The
// spread is taken robustly (median absolute value) and lower orders are used where they give less, so
// that motion does not count as noise. Fewer than order + 4 values: stddev 0.
SignalNoise EstimateNoise(const Eigen::VectorXd& t, const Eigen::VectorXd& x, int order = 5);

struct SensorNoise {
  Eigen::VectorXd position_stddev;      // n
  Eigen::VectorXd velocity_stddev;      // n; of SmoothVelocity's estimate where v is not measured
  Eigen::VectorXd position_resolution;  // n
};

// Per joint, over the set's recordings; entries of set.noise are taken as they are.
SensorNoise EstimateSensorNoise(const RecordingSet& set);

struct VelocityOptions {
  double position_stddev = 0.0;  // rad or m; 0: estimated from the data
  double span_s = 0.0;           // time over which a polynomial is fitted; 0: chosen from the data
  int degree = 2;
};

struct StateEstimate {
  Eigen::VectorXd q;         // n
  Eigen::VectorXd v;         // n
  Eigen::VectorXd v_stddev;  // n, from the position noise alone
};

// Position and velocity at row `row` by a local polynomial through rows at or before it: what a
// prediction may know at a restart. Rows after `row` are not read. With too few rows before, what
// there is decides (one row: q as measured, v = 0).
StateEstimate EstimateStateCausal(const Recording& recording, int row, const VelocityOptions& options = {});

// n × K velocities by local polynomials centred on each row, for fitting. Measured velocities are not
// looked at.
Eigen::MatrixXd SmoothVelocity(const Recording& recording, const VelocityOptions& options = {});

// The measured velocity where there is one, else SmoothVelocity.
Eigen::MatrixXd VelocityOrEstimate(const Recording& recording, const VelocityOptions& options = {});

}  // namespace rg::recordings
