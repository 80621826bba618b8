// A whole fit by multiple shooting: short windows first, since they forgive a poor start, then long ones.
//
// The scale of the residuals is what they show themselves, never below the sensors' noise. For the long
// windows it is multiplied by the root of the short windows' variance inflation: under a wrong model windows
// err together, and must not outvote the priors. Where more than a fifth of the long
// windows cannot be simulated (a motion too unstable for them), the short ones have the last word.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <vector>

#include "common/base/progress.h"
#include "common/recordings/noise.h"
#include "common/sim/plant.h"
#include "services/sysid/fit_space.h"
#include "services/sysid/identifiability.h"
#include "services/sysid/recording_shooting.h"

namespace rg::sysid {

struct ShootingFitOptions {
  double first_window_s = 0.25;
  double window_s = 1.0;
  int first_max_windows = 120;  // of the short ones, thinned evenly
  // Further rounds of long windows, as long as each round's residuals show that its scale was much too wide:
  // from a poor start with few data the first scales leave the priors too much say.
  int refinements = 0;
  double residual_rate_hz = 25.0;
  bool use_velocity = true;
  double internal_state_stddev = 0.0;
  double huber = 3.0;
  int max_iterations = 12;           // per round
  double relative_tolerance = 1e-3;  // of the cost, ends a round
  int threads = 1;
  sim::SimulatorOptions simulator;
};

struct ShootingFit {
  Eigen::VectorXd theta;      // in the fit space
  Eigen::VectorXd values;     // of the plant's table
  ShootingSolution solution;  // of the last round; information is empty when no round was done
  ShootingScales scales;      // that the solution was whitened with
  double window_s = 0.0;      // of that round
};

// Starts at `theta` (of a regression, or space.nominal()); other parameters are those of `values`.
// `after_round` (may be empty) sees the fit after each round. `progress`: stage "shooting".
ShootingFit FitByShooting(const sim::Plant& plant, const Eigen::VectorXd& values, const FitSpace& space,
                          const Eigen::VectorXd& theta, const std::vector<FitRecording>& recordings,
                          const recordings::SensorNoise& noise, const ShootingFitOptions& options,
                          const StopCondition& stop,
                          const std::function<void(const ShootingFit&)>& after_round = {},
                          const ProgressFn& progress = {});

// Without fitting: what windows of options.window_s determine at `fit`, for a start that no round was better
// than. The fit's residuals set the scales as they do in a round.
void AddInformation(const sim::Plant& plant, const FitSpace& space,
                    const std::vector<FitRecording>& recordings, const recordings::SensorNoise& noise,
                    const ShootingFitOptions& options, const StopCondition& stop, ShootingFit* fit);

// Noise no smaller than what a double of a sensor can mean; scales must not be zero.
recordings::SensorNoise FlooredNoise(recordings::SensorNoise noise);

// Identifiability of the fit in the parameters people know; empty when the fit has no information.
IdentifiabilityReport IdentifiabilityOf(const FitSpace& space, const ShootingFit& fit);
// What Identify asks of them, for `information` on θ (P × P) at `theta`; the nominal values are the plant's.
IdentifiabilityInput IdentifiabilityInputOf(const FitSpace& space, const Eigen::VectorXd& theta,
                                            const Eigen::MatrixXd& information);

// The longest of a few steps (8 to 1 ms) whose error in windows simulated at `theta` is below a fifth of the
// sensors' noise, or below 2 % of the model's own error.
double ChooseStep(const sim::Plant& plant, const Eigen::VectorXd& values, const FitSpace& space,
                  const Eigen::VectorXd& theta, const std::vector<FitRecording>& recordings,
                  const recordings::SensorNoise& noise, double window_s = 0.5);

}  // namespace rg::sysid
