#include "services/rollouts/scoring.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <utility>
#include <vector>

#include "common/dynamics/dynamics.h"
#include "common/model/robot_model.h"
#include "common/recordings/command_time.h"
#include "common/recordings/noise.h"
#include "common/recordings/windows.h"
#include "common/sim/holding_command.h"

namespace rg::rollouts {
namespace {

using recordings::Recording;

sim::CommandSignal CommandOf(const Recording& recording) {
  const bool command = recording.drive == recordings::EffortKind::kCommand;
  const Eigen::VectorXd& at = command ? recordings::CommandTimes(recording) : recording.t;
  std::vector<double> times(at.data(), at.data() + at.size());
  auto signal = sim::CommandSignal::Create(std::move(times), recording.drive_effort(),
                                           command ? sim::Hold::kZeroOrder : sim::Hold::kLinear);
  return std::move(signal).value();  // readers of recordings refuse what Create refuses
}

Eigen::VectorXd VelocityAt(const Recording& recording, int row) {
  if (recording.has_velocity()) return recording.v.col(row);
  return recordings::EstimateStateCausal(recording, row).v;
}

// Simulates one window into the columns first + 1 … last of `position`. Rows that a simulation that broke
// down did not reach get its last position.
void RunWindow(const Recording& recording, const sim::CommandSignal& command,
               const recordings::Window& window, sim::Simulator& simulator, SimulationError* error) {
  int row = window.first;
  double begin = row == 0 ? recordings::MotionBegin(recording) : recording.t[row];
  if (begin >= recording.t[window.last]) begin = recording.t[row];
  Eigen::VectorXd velocity = VelocityAt(recording, row);
  if (begin > recording.t[row]) velocity.setZero();
  for (; recording.t[row + 1] <= begin; ++row) error->position.col(row + 1) = recording.q.col(window.first);
  const std::vector<double> times(recording.t.data() + row + 1, recording.t.data() + window.last + 1);
  const sim::State start =
      simulator.MakeStateFromMeasurement(recording.q.col(window.first), velocity, begin, command);
  const sim::Trajectory out = simulator.Simulate(start, command, times);
  const int reached = out.outcome.ok() ? static_cast<int>(times.size()) : out.reached;
  error->position.middleCols(row + 1, reached) = out.position.leftCols(reached);
  if (out.outcome.ok()) return;
  error->ok = false;
  error->failure = out.outcome.ToString();
  for (int k = row + 1 + reached; k <= window.last; ++k) {
    error->position.col(k) = error->position.col(row + reached);
  }
}

void Accumulate(const Recording& recording, const Eigen::MatrixXd& tip, const Eigen::MatrixXd& simulated_tip,
                int first, int count, SimulationError* error) {
  for (int k = first; k < first + count; ++k) {
    const Eigen::VectorXd joint = recording.q.col(k) - error->position.col(k);
    const double distance = (tip.col(k) - simulated_tip.col(k)).norm();
    error->residual += joint.squaredNorm();
    error->joint_rms_each.array() += joint.array().square();
    error->accumulated_tip_m += distance;
    error->tip_rms_m += distance * distance;
    error->tip_max_m = std::max(error->tip_max_m, distance);
  }
  error->rows += count;
}

void Finish(int n, SimulationError* error) {
  const double rows = std::max(error->rows, 1);
  error->joint_rms = std::sqrt(error->residual / (rows * n));
  error->joint_rms_each = (error->joint_rms_each / rows).cwiseSqrt();
  error->tip_rms_m = std::sqrt(error->tip_rms_m / rows);
}

}  // namespace

Eigen::MatrixXd TipPositions(const model::RobotModel& model, const Eigen::MatrixXd& q) {
  const dynamics::Mechanism mechanism(model);
  dynamics::Workspace workspace;
  const auto frame = model.FindFrame(model.end_effector().name);
  RG_CHECK(frame.has_value());
  Eigen::MatrixXd tip(3, q.cols());
  for (Eigen::Index k = 0; k < q.cols(); ++k)
    tip.col(k) = dynamics::FramePose(mechanism, workspace, q.col(k), *frame).translation;
  return tip;
}

GoalError ScoreGoal(const model::RobotModel& model, const Recording& recording, const Eigen::VectorXd& goal) {
  const int last = recording.rows() - 1;
  RG_CHECK(last >= 0 && goal.size() == recording.n());
  GoalError error;
  const Eigen::VectorXd at_end = recording.q.col(last) - goal;
  error.joint_norm = at_end.norm();
  error.joint_max = at_end.cwiseAbs().maxCoeff();
  error.start_norm = (recording.q.col(0) - goal).norm();
  const Eigen::MatrixXd tip = TipPositions(model, recording.q);
  const Eigen::VectorXd distance = (tip.colwise() - TipPositions(model, goal).col(0)).colwise().norm();
  error.tip_distance = distance[last];
  error.closest_tip = distance.minCoeff();
  int rows = 0;
  for (int k = last; k >= 0 && recording.t[k] >= recording.t[last] - 1.0; --k, ++rows)
    error.last_second_norm += (recording.q.col(k) - goal).norm();
  error.last_second_norm /= rows;
  return error;
}

std::string GoalError::ToJson() const {
  return nlohmann::json{{"joint_norm", joint_norm},       {"joint_max", joint_max},
                        {"tip_distance_m", tip_distance}, {"closest_tip_m", closest_tip},
                        {"start_norm", start_norm},       {"last_second_norm", last_second_norm}}
      .dump();
}

SimulationError ScoreSimulation(const sim::Plant& plant, const Eigen::VectorXd& values,
                                const Recording& recording, const SimulationScoreOptions& options) {
  const int n = recording.n();
  RG_CHECK(n == plant.num_joints());
  SimulationError error;
  error.ok = true;
  error.position = recording.q;
  error.joint_rms_each = Eigen::VectorXd::Zero(n);
  sim::Simulator simulator(plant, options.simulator);
  simulator.SetParameters(values);
  sim::CommandSignal command = CommandOf(recording);
  if (recordings::StartsAtRest(recording))
    command =
        sim::HeldBefore(command, sim::HoldingCommand(simulator, recording.q.col(0), command.values().col(0)));
  std::vector<std::pair<int, int>> compared;  // first row, count
  for (const auto& window : recordings::SplitIntoWindows(recording, options.window_s)) {
    RunWindow(recording, command, window, simulator, &error);
    compared.emplace_back(window.first + 1, window.rows());
  }
  const Eigen::MatrixXd tip = TipPositions(plant.model(), recording.q);
  const Eigen::MatrixXd simulated_tip = TipPositions(plant.model(), error.position);
  for (const auto& [first, count] : compared) Accumulate(recording, tip, simulated_tip, first, count, &error);
  Finish(n, &error);
  return error;
}

std::string SimulationError::ToJson() const {
  const std::vector<double> each(joint_rms_each.data(), joint_rms_each.data() + joint_rms_each.size());
  return nlohmann::json{{"ok", ok},
                        {"failure", failure},
                        {"rows", rows},
                        {"residual", residual},
                        {"accumulated_tip_m", accumulated_tip_m},
                        {"joint_rms", joint_rms},
                        {"tip_rms_m", tip_rms_m},
                        {"tip_max_m", tip_max_m},
                        {"joint_rms_each", each}}
      .dump();
}

}  // namespace rg::rollouts
