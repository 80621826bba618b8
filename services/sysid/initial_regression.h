// Where to start: least squares of the inverse dynamics on smoothed recordings.
//
//   g·u  =  Y(q, v, a) φ(p)  +  friction and rotor terms(v, a, p)  +  ε        per joint and row
//
// Positions are smoothed by local cubics (value, slope and second derivative), the effort by the same
// cubics, so that both have lost the same frequencies. Linear in all but the centres of mass: a few
// Gauss-Newton steps. Rows in which a joint hardly moves have no say for that joint: what friction does
// there is anything up to its level. Prescribed joints have no equation of their own; their motion is in the
// others'. Huber weights, the residual's scale per joint estimated on the way,
// priors and bounds of the fit space. No offset per joint: the model has none to predict with.
// Parameters that this equation does not hold (delays, elasticity, …) keep their start value.
//
// Biased by noise in the regressors and blind to what happens between rows, but it needs no simulation,
// has no local minima, and never leaves a friction on its bound.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "common/effects/inference.h"
#include "common/recordings/recording.h"
#include "common/sim/command_signal.h"
#include "common/sim/plant.h"
#include "services/sysid/fit_space.h"

namespace rg::sysid {

// A recording made ready for fitting; both outlive what uses them.
struct FitRecording {
  const recordings::Recording* recording = nullptr;
  sim::CommandSignal command;
};

// Motion and effort at one moment, all smoothed alike, n each.
struct MotionSample {
  Eigen::VectorXd q, v, a, effort;
};

struct RegressionOptions {
  double rate_hz = 50.0;      // rows are thinned to about this rate
  int max_rows = 3000;        // over all recordings
  double half_span_s = 0.05;  // of the local cubics; at least three rows to each side
  double still_share = 0.05;  // a joint slower than this share of its RMS speed counts as still
  double huber = 2.0;
  int iterations = 6;
};

// A force on a joint beside the plant's own, linear in one coefficient: for laws whose parameters are no
// coefficients themselves.
struct RegressionColumn {
  int joint = 0;
  effects::Regressor regressor;  // that the regression has
  double shape = 0;
  double prior_stddev = 1;  // of its coefficient about 0
};

struct RegressionResult {
  Eigen::VectorXd theta;          // in the fit space
  Eigen::VectorXd coefficients;   // of the further columns
  Eigen::VectorXd torque_stddev;  // n, robust, of the residual
  int rows = 0;                   // rows used; 0: too little data, theta is the start
};

// What a regressor's coefficient multiplies on the model's side of a joint's torque balance; q: less the
// regressor's shape. Nothing where the regression does not know it.
std::optional<double> RegressionColumnOf(effects::Regressor regressor, double q, double v, double a);
// Whether it holds an effect: all of its force is a sum of its parameters times such columns, without shapes.
bool RegressionKnows(const std::string& effect);

// Samples of the recordings, thinned.
std::vector<MotionSample> SampleMotion(const std::vector<FitRecording>& recordings,
                                       const RegressionOptions& options = {});

// Starts at `theta`; the plant's other parameters are those of `values` (its whole table). `further`: columns
// whose coefficients are estimated together with θ.
RegressionResult RegressInverseDynamics(const sim::Plant& plant, const Eigen::VectorXd& values,
                                        const FitSpace& space, const Eigen::VectorXd& theta,
                                        const std::vector<FitRecording>& recordings,
                                        const RegressionOptions& options = {},
                                        const std::vector<RegressionColumn>& further = {});

}  // namespace rg::sysid
