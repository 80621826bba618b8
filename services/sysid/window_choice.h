// Which windows of the recordings to fit, when only some shall be: the paper fits 0.2 s of 8 s and names
// the choice of the window by its information as future work.
//
// Of every candidate window w the model says, before any fit, what it would tell: with J_w the
// sensitivities of its whitened residuals to the parameters θ and its initial state eliminated,
//
//   H_w = J_wᵀ J_w (Schur complement),   gain(w | H) = ½ [log det(1 + D(H + H_w)D) − log det(1 + D H D)]
//
// in nats, D = diag(prior stddev): Bayesian D-optimality with noise and prior. It is averaged over several θ
// from the prior, since which window is informative depends on the robot, which is not known yet. A
// residual that θ may move by s (the prior's spread of it, in SI units) is linear in θ only up to about
// kCurvature · s²; that counts as noise beside the sensors', else windows in which an unstable
// motion grows would seem to tell most. Windows are taken greedily, the best first (log det is
// submodular, so this is within 1 − 1/e of the best set), none overlapping another that was taken.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.h"
#include "common/recordings/noise.h"
#include "common/sim/plant.h"
#include "common/sim/simulator.h"
#include "services/sysid/fit_space.h"
#include "services/sysid/initial_regression.h"

namespace rg::sysid {

enum class WindowChoice { kFirst, kRandom, kInformation };
std::string_view WindowChoiceName(WindowChoice choice);  // "first", "random", "information"
Result<WindowChoice> ParseWindowChoice(std::string_view name);

struct FitWindow {
  int recording = 0;        // index into what was chosen from
  int first = 0, last = 0;  // rows, both in the window
  double start_s = 0.0;     // of its first row, in the recording's time
  double length_s = 0.0;    // to its last row
  double gain_nats = 0.0;   // when it was taken; 0 unless chosen by information
};

// All windows of `window_s` (at least two rows), half a window apart.
std::vector<FitWindow> CandidateWindows(const std::vector<FitRecording>& recordings, double window_s);

// Where information is asked for: the first is what is to be expected before any data, nominal values, or
// the mean of the half-normal prior where they lie on a lower bound, as friction that a URDF does not declare
// (a model without any friction is too unstable to say what a window tells); the others are drawn.
std::vector<Eigen::VectorXd> PriorPoints(const FitSpace& space, int count, uint64_t seed);

inline constexpr double kCurvature = 0.5;  // 1/rad

struct WindowInformationOptions {
  // Of the initial states, which are measured: eliminated with their sensors' noise as prior. False: they
  // are taken as measured, as the paper does.
  bool initial_states_unknown = true;
  bool use_velocity = true;
  sim::SimulatorOptions simulator;
  int threads = 1;
};

// H_w of each window, P × P, at θ; zero where its simulation is not finite.
std::vector<Eigen::MatrixXd> InformationOfWindows(const sim::Plant& plant, const Eigen::VectorXd& values,
                                                  const FitSpace& space, const Eigen::VectorXd& theta,
                                                  const std::vector<FitRecording>& recordings,
                                                  const std::vector<FitWindow>& windows,
                                                  const recordings::SensorNoise& noise,
                                                  const WindowInformationOptions& options);

// Up to `count` windows that do not overlap, in the order of their choice. `information`: H_w of every window
// at each of the prior's points.
std::vector<FitWindow> TakeMostInformative(const std::vector<FitWindow>& windows,
                                           const std::vector<std::vector<Eigen::MatrixXd>>& information,
                                           const Eigen::VectorXd& prior_stddev, int count);
// All of it: information at kPriorPoints, and the best windows by it.
inline constexpr int kPriorPoints = 5;
std::vector<FitWindow> ChooseByInformation(const sim::Plant& plant, const Eigen::VectorXd& values,
                                           const FitSpace& space, const std::vector<FitRecording>& recordings,
                                           const std::vector<FitWindow>& windows,
                                           const recordings::SensorNoise& noise, int count,
                                           const WindowInformationOptions& options);
std::vector<FitWindow> TakeAtRandom(std::vector<FitWindow> windows, uint64_t seed, int count);
std::vector<FitWindow> TakeFirst(const std::vector<FitWindow>& windows, int count);

}  // namespace rg::sysid
