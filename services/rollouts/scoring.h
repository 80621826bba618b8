// How well a rollout did, and how well a simulation tells what the robot did.
#pragma once

#include <Eigen/Core>
#include <limits>
#include <string>

#include "common/base/status.h"
#include "common/recordings/recording.h"
#include "common/sim/plant.h"
#include "common/sim/simulator.h"

namespace rg::rollouts {

// Origin of the end-effector frame in the base frame for each column of q (n × K): 3 × K, m.
Eigen::MatrixXd TipPositions(const model::RobotModel& model, const Eigen::MatrixXd& q);

struct GoalError {
  double joint_norm = 0.0;        // |q_end - goal|, rad
  double joint_max = 0.0;         // largest joint error at the end, rad
  double tip_distance = 0.0;      // end effector to its place at the goal, m, at the end
  double closest_tip = 0.0;       // the smallest such distance on the way, m
  double start_norm = 0.0;        // |q_start - goal|, what had to be covered, rad
  double last_second_norm = 0.0;  // mean of |q - goal| over the last second, rad
  std::string ToJson() const;
};
// recording in model order with at least one row; goal: n.
GoalError ScoreGoal(const model::RobotModel& model, const recordings::Recording& recording,
                    const Eigen::VectorXd& goal);

struct SimulationError {
  bool ok = false;                 // false: the simulation broke down; from there its last position counts
  std::string failure;             // "not finite at step 812 (t = 0.812 s), joint_6"
  int rows = 0;                    // compared
  double residual = 0.0;           // Σ_k Σ_j (q - q̂)², rad²: the paper's without its second term
  double accumulated_tip_m = 0.0;  // Σ_k |p - p̂|, m: the paper's accumulated Euclidean distance
  double joint_rms = 0.0;          // over rows and joints, rad
  double tip_rms_m = 0.0;
  double tip_max_m = 0.0;
  Eigen::VectorXd joint_rms_each;  // n
  Eigen::MatrixXd position;        // n × rows, the simulation, for plots
  std::string ToJson() const;      // without `position`
};
// Runs the recorded effort through the plant at `values` from the first measured state, restarted at
// the measured state every window_s as predictions are (infinity: once, as in the paper). Velocity at
// a restart: the measured one, else estimated from rows up to there. Times relative to the recording.
struct SimulationScoreOptions {
  double window_s = std::numeric_limits<double>::infinity();
  sim::SimulatorOptions simulator;
};
SimulationError ScoreSimulation(const sim::Plant& plant, const Eigen::VectorXd& values,
                                const recordings::Recording& recording,
                                const SimulationScoreOptions& options = {});

}  // namespace rg::rollouts
