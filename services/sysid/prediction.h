// Predictions of a recording in restarted windows, as the contract of recordings defines them.
//
// With t0 the time of the first row and W the window, the simulation starts anew at the first row at or
// after t0 + k·W (half a sample of tolerance) and runs the recorded effort open loop to the window's end.
// A restart row carries the prediction of the window that ends there; the first row, and the first row after
// a gap (recordings/time_stamps.h), carry the measured state. Nothing after a restart row is used for its
// state, and nothing before a gap for one behind it.
//
// The state at a restart: measured position and velocity, or better, a causal estimate from the rows up
// to and including it. The estimate is an extended Kalman filter over the model itself: hidden states
// (motors behind springs, bristles, lags) then start from what precedes, and a missing velocity is
// estimated with the model's help. The process noise is chosen among several levels by the likelihood of
// the rows so far, so that a wrong model falls back on
// the sensors by itself.
#pragma once

#include <Eigen/Core>
#include <limits>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "common/recordings/noise.h"
#include "common/recordings/recording.h"
#include "common/sim/plant.h"
#include "common/sim/simulator.h"

namespace rg::sysid {

enum class RestartState {
  kMeasured,  // the row itself; missing velocities by EstimateStateCausal; hidden states settled
  kFiltered,  // the causal filter
};

struct PredictionOptions {
  double window_s = 1.0;  // infinity: one window
  RestartState restart = RestartState::kFiltered;
  sim::SimulatorOptions simulator;
  // Of the sensors; entries of size 0 are estimated from the recording.
  recordings::SensorNoise noise;
  bool effort_excludes_gravity = false;  // the drive adds its own, with `drive_values` of the plant
  Eigen::VectorXd drive_values;          // empty: the plant's nominal values
  // What late drives follow before a recording of a robot at rest: the command that held it (sim::ModelFile).
  bool held_before = true;
};

struct Prediction {
  Eigen::VectorXd t;          // K
  Eigen::MatrixXd q;          // n × K
  std::vector<int> restarts;  // rows at which a window starts, 0 first
  std::vector<int> measured;  // those of them that carry the measured state: 0, and the first after each gap
  // One line per window in which the simulation broke down; there the last finite position is repeated.
  std::vector<std::string> failures;
};

// `values`: of the plant's table. The recording's joints are the plant's, in the plant's order, and so are
// its prescribed ones, which are written as measured.
Prediction PredictRecording(const sim::Plant& plant, const Eigen::VectorXd& values,
                            const recordings::Recording& recording, const PredictionOptions& options = {});

// Errors count up to kErrorCap each: a simulation that explodes is wrong, not infinitely wrong.
inline constexpr double kErrorCap = 1e3;  // rad or m

struct PredictionError {
  double rms = 0.0;             // over all rows that are predicted, all joints but prescribed ones
  double median_window = 0.0;   // of `windows`
  Eigen::VectorXd joint_rms;    // n
  std::vector<double> windows;  // RMS of each window
};
PredictionError ErrorOf(const Prediction& prediction, const recordings::Recording& recording);

// "time,position.<joint>…", one line per row, angles in the wrapping of the recording's file.
std::string FormatPredictionCsv(const Prediction& prediction, const recordings::Recording& recording);

}  // namespace rg::sysid
