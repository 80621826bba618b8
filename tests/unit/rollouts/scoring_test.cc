#include "services/rollouts/scoring.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>

#include "common/model/urdf_loader.h"

namespace rg::rollouts {
namespace {

using recordings::Recording;

std::shared_ptr<const model::RobotModel> SharedArm() {
  const std::string root = std::getenv("RG_SOURCE_DIR");
  return std::make_shared<const model::RobotModel>(
      model::LoadUrdf(root + "/deploy/robots/arm2.urdf").value());
}

// What the plant itself does under small torques, as a recording at 25 Hz.
Recording Simulated(const sim::Plant& plant, const Eigen::VectorXd& values, int rows) {
  const int n = plant.num_joints();
  Recording recording;
  recording.joints = plant.joint_names();
  recording.t = Eigen::VectorXd::LinSpaced(rows, 0, 0.04 * (rows - 1));
  recording.effort_command = Eigen::MatrixXd::Zero(n, rows);
  for (int k = 0; k < rows; ++k) recording.effort_command(0, k) = 0.3 * std::sin(0.4 * k);
  sim::Simulator simulator(plant);
  simulator.SetParameters(values);
  std::vector<double> times(recording.t.data(), recording.t.data() + rows);
  const auto command =
      sim::CommandSignal::Create(times, recording.effort_command, sim::Hold::kZeroOrder).value();
  const auto start =
      simulator.MakeState(Eigen::VectorXd::Constant(n, 0.2), Eigen::VectorXd::Zero(n), 0, command);
  const auto out = simulator.Simulate(start, command, times);
  recording.q = out.position;
  recording.v = out.velocity;
  return recording;
}

TEST(ScoreGoal, MeasuresTheEndAndTheWay) {
  const auto model = SharedArm();
  Recording recording;
  recording.t = Eigen::Vector3d(0, 1, 2);
  recording.q = Eigen::MatrixXd::Zero(2, 3);
  recording.q.col(0) << 1.0, 0.0;
  recording.q.col(2) << 0.3, -0.4;
  const GoalError error = ScoreGoal(*model, recording, Eigen::Vector2d::Zero());
  EXPECT_NEAR(error.joint_norm, 0.5, 1e-12);
  EXPECT_NEAR(error.joint_max, 0.4, 1e-12);
  EXPECT_NEAR(error.start_norm, 1.0, 1e-12);
  EXPECT_NEAR(error.last_second_norm, 0.25, 1e-12);
  EXPECT_NEAR(error.closest_tip, 0.0, 1e-12);
  const Eigen::MatrixXd tip = TipPositions(*model, recording.q);
  EXPECT_NEAR(error.tip_distance, (tip.col(2) - tip.col(1)).norm(), 1e-12);
}

TEST(ScoreSimulation, TheTrueParametersScoreZeroAndOthersDoNot) {
  const sim::Plant plant = sim::Plant::Create(SharedArm()).value();
  const Eigen::VectorXd truth = plant.parameters().Nominal();
  const Recording recording = Simulated(plant, truth, 26);
  const SimulationError exact = ScoreSimulation(plant, truth, recording);
  EXPECT_TRUE(exact.ok);
  EXPECT_EQ(exact.rows, 25);
  EXPECT_LT(exact.accumulated_tip_m, 1e-9);
  Eigen::VectorXd wrong = truth;
  wrong[plant.parameters().Find("gravity.z")] *= 0.8;
  const SimulationError off = ScoreSimulation(plant, wrong, recording);
  EXPECT_GT(off.accumulated_tip_m, 1e-2);
  EXPECT_NEAR(off.residual, off.joint_rms * off.joint_rms * 25 * 2, 1e-9 * off.residual);
  EXPECT_NEAR(off.joint_rms_each.squaredNorm() * 25, off.residual, 1e-9 * off.residual);
}

TEST(ScoreSimulation, RestartsMakeAWrongModelLookBetter) {
  const sim::Plant plant = sim::Plant::Create(SharedArm()).value();
  const Eigen::VectorXd truth = plant.parameters().Nominal();
  const Recording recording = Simulated(plant, truth, 51);
  Eigen::VectorXd wrong = truth;
  wrong[plant.parameters().Find("gravity.z")] *= 0.8;
  const double whole = ScoreSimulation(plant, wrong, recording).joint_rms;
  const double windows =
      ScoreSimulation(plant, wrong, recording, {.window_s = 0.2, .simulator = {}}).joint_rms;
  EXPECT_LT(windows, 0.5 * whole);
}

}  // namespace
}  // namespace rg::rollouts
