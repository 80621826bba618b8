// What is measured: the arm with damping as the paper found it, its motion, recordings, data. Private to
// this folder.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/base/clock.h"
#include "common/recordings/recording.h"
#include "common/sim/simulator.h"
#include "services/policy/dataset.h"
#include "services/trajectories/shard.h"

namespace rg::lab {

// CPU time of the calling thread.
class ThreadCpuClock final : public Clock {
 public:
  int64_t SteadyNanos() const override;
  int64_t WallNanos() const override { return RealClock().WallNanos(); }
};

double Median(std::vector<double> values);

// Median CPU seconds of one call of `body`, in batches long enough to be timed.
template <class Body>
double SecondsPerCall(const Body& body, int batches, int* samples) {
  const ThreadCpuClock clock;
  int calls = 1;
  for (double seconds = 0; seconds < 1e-3; calls *= 2) {
    const double start = clock.SteadySeconds();
    for (int i = 0; i < calls; ++i) body();
    seconds = clock.SteadySeconds() - start;
  }
  std::vector<double> values;
  for (int b = 0; b < batches; ++b) {
    const double start = clock.SteadySeconds();
    for (int i = 0; i < calls; ++i) body();
    values.push_back((clock.SteadySeconds() - start) / calls);
  }
  *samples = batches;
  return Median(std::move(values));
}

// The arm moving for `seconds` under held torques at 25 Hz from a bent pose.
struct MovingArm {
  MovingArm(std::shared_ptr<const model::RobotModel> robot, std::vector<effects::EffectSpec> effects,
            double seconds, double step_s = 1e-3);
  // One whole simulation with sensitivities to the paper's parameters. False: it broke down.
  bool SimulateWithSensitivities();
  // The motion cut into `count` windows of equal length, each from the state it passes: what
  // SimulateSideBySide runs, in SIMD lanes, with the same sensitivities. False: it broke down.
  bool CutIntoWindows(int count);
  bool SimulateSideBySide();

  sim::Plant plant;
  Eigen::VectorXd values;  // damped
  sim::Simulator simulator;
  std::vector<int> parameters;  // the paper's
  std::vector<double> times;
  sim::CommandSignal command;
  sim::State x0;
  sim::Trajectory out;
  std::vector<std::vector<double>> window_times;
  std::vector<sim::SimulationWindow> windows;
  std::vector<sim::Trajectory> window_out;
};

// Joint damping as the paper identified it, as far as the robot has joints.
Eigen::VectorXd DampedValues(const sim::Plant& plant);
std::vector<effects::EffectSpec> FrictionElasticityLagDelay(const std::vector<std::string>& joints);

// `seconds` of a multi-sine motion under computed torque, 100 Hz, with the sensors' noise.
recordings::Recording RecordMotion(const sim::Plant& plant, const Eigen::VectorXd& values, double seconds,
                                   uint64_t seed);
inline constexpr double kPositionNoise = 3e-4, kVelocityNoise = 1e-2;  // rad, rad/s

trajectories::ShardSpec PaperShard(const sim::Plant& plant, uint64_t seed);

// 450 trajectories of 25 points of a stiff feedback law with gravity: the paper's size.
policy::Dataset PaperSizedDataset(int joints, uint64_t seed);

}  // namespace rg::lab
