#include "services/lab/subjects.h"

#include <time.h>

#include <algorithm>
#include <cmath>

#include "common/base/check.h"
#include "common/base/rng.h"
#include "common/dynamics/dynamics.h"
#include "common/model/robot_model.h"
#include "services/sysid/drive_signal.h"

namespace rg::lab {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

sim::Plant MakePlant(std::shared_ptr<const model::RobotModel> robot,
                     std::vector<effects::EffectSpec> effects) {
  auto plant = sim::Plant::Create(std::move(robot), {}, std::move(effects));
  RG_CHECK(plant.ok()) << plant.status().ToString();
  return *std::move(plant);
}

// Inside the limits, bent, so that gravity acts on every joint.
VectorXd BentPose(const model::RobotModel& robot) {
  VectorXd q(robot.num_joints());
  const double bend[] = {0.0, 2.8, 2.6, 0.3, 0.2, 0.1};
  for (int j = 0; j < q.size(); ++j) {
    q[j] = j < 6 ? bend[j] : 0.1;
    if (std::isfinite(robot.joint(j).lower) && std::isfinite(robot.joint(j).upper))
      q[j] = std::clamp(q[j], robot.joint(j).lower, robot.joint(j).upper);
  }
  return q;
}

// Three sines per joint.
struct MultiSine {
  MultiSine(const VectorXd& center, uint64_t seed) : center(center) {
    Rng rng(seed);
    frequency.resize(center.size(), 3), phase.resize(center.size(), 3);
    for (Eigen::Index i = 0; i < frequency.size(); ++i) {
      frequency.data()[i] = 2.0 * M_PI * rng.Uniform(0.15, 0.9);
      phase.data()[i] = rng.Uniform(0.0, 2.0 * M_PI);
    }
  }
  void At(double t, VectorXd* q, VectorXd* v, VectorXd* a) const {
    *q = center, v->setZero(center.size()), a->setZero(center.size());
    for (Eigen::Index j = 0; j < center.size(); ++j) {
      for (int m = 0; m < 3; ++m) {
        const double w = frequency(j, m), s = 0.2, x = w * t + phase(j, m);
        (*q)[j] += s * std::sin(x), (*v)[j] += s * w * std::cos(x), (*a)[j] -= s * w * w * std::sin(x);
      }
    }
  }
  VectorXd center;
  MatrixXd frequency, phase;
};

}  // namespace

int64_t ThreadCpuClock::SteadyNanos() const {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return 1'000'000'000 * static_cast<int64_t>(now.tv_sec) + now.tv_nsec;
}

double Median(std::vector<double> values) {
  RG_CHECK(!values.empty());
  std::sort(values.begin(), values.end());
  const size_t half = values.size() / 2;
  return values.size() % 2 ? values[half] : 0.5 * (values[half - 1] + values[half]);
}

VectorXd DampedValues(const sim::Plant& plant) {
  const double damping[] = {12.12, 15.18, 17.56, 3.63, 4.31, 4.27};
  VectorXd p = plant.parameters().Nominal();
  for (int j = 0; j < std::min(6, plant.num_joints()); ++j)
    p[plant.parameters().Find("damping." + plant.joint_names()[static_cast<size_t>(j)])] = damping[j];
  return p;
}

std::vector<effects::EffectSpec> FrictionElasticityLagDelay(const std::vector<std::string>& joints) {
  using effects::MakeSpec;
  return {MakeSpec("coulomb_friction", joints, {{"coulomb", 0.3}}),
          MakeSpec("joint_elasticity", joints, {{"stiffness", 1e4}, {"damping", 2}, {"motor_inertia", 0.05}}),
          MakeSpec("actuator_lag", joints, {{"time_constant", 0.01}}),
          MakeSpec("actuator_delay", joints, {{"delay", 0.005}})};
}

MovingArm::MovingArm(std::shared_ptr<const model::RobotModel> robot, std::vector<effects::EffectSpec> effects,
                     double seconds, double step_s)
    : plant(MakePlant(std::move(robot), std::move(effects))),
      values(DampedValues(plant)),
      simulator(plant, {.step_s = step_s}),
      parameters(sim::PaperParameters(plant)) {
  simulator.SetParameters(values);
  const int n = plant.num_joints(), rows = static_cast<int>(std::lround(25 * seconds)) + 1;
  MatrixXd u(n, rows);
  for (int k = 0; k < rows; ++k) {
    times.push_back(0.04 * k);
    for (int j = 0; j < n; ++j) u(j, k) = (j < 3 ? 6.0 : 1.5) * std::sin(0.13 * k + j);
  }
  command = sim::CommandSignal::Create(times, u, sim::Hold::kZeroOrder).value();
  x0 = simulator.MakeState(BentPose(plant.model()), VectorXd::Zero(n), 0.0, command);
}

bool MovingArm::SimulateWithSensitivities() {
  simulator.SimulateInto(x0, command, times, {.initial_state = false, .parameters = parameters}, &out);
  return out.outcome.ok();
}

bool MovingArm::CutIntoWindows(int count) {
  const int n = plant.num_joints(), rows = static_cast<int>(times.size()) - 1;
  if (!SimulateWithSensitivities()) return false;
  window_times.assign(static_cast<size_t>(count), {});
  windows.clear();
  for (int w = 0; w < count; ++w) {
    const int first = rows * w / count, last = rows * (w + 1) / count;
    std::vector<double>& own = window_times[static_cast<size_t>(w)];
    own.assign(times.begin() + first, times.begin() + last + 1);
    sim::State start = simulator.MakeState(out.state.col(first).head(n), out.state.col(first).segment(n, n),
                                           times[static_cast<size_t>(first)], command);
    start.z = out.state.col(first).tail(start.z.size());
    windows.push_back({start, &command, &own});
  }
  return true;
}

bool MovingArm::SimulateSideBySide() {
  simulator.SimulateWindows(windows, {.initial_state = false, .parameters = parameters}, &window_out);
  for (const sim::Trajectory& window : window_out) {
    if (!window.outcome.ok()) return false;
  }
  return true;
}

recordings::Recording RecordMotion(const sim::Plant& plant, const VectorXd& values, double seconds,
                                   uint64_t seed) {
  constexpr double kRate = 100.0;
  const int n = plant.num_joints(), rows = static_cast<int>(std::lround(seconds * kRate)) + 1;
  const MultiSine reference(BentPose(plant.model()), seed);
  const dynamics::Mechanism mechanism = sysid::MechanismOf(plant, values);
  dynamics::Workspace workspace;
  sim::Simulator simulator(plant, {.step_s = 1e-3});
  simulator.SetParameters(values);
  VectorXd q, v, a, u(n);
  reference.At(0, &q, &v, &a);
  sim::State x = simulator.MakeState(q, v);
  Rng rng(seed + 1);
  recordings::Recording out;
  out.name = "bench";
  out.joints = plant.joint_names();
  out.t.resize(rows);
  out.q.resize(n, rows), out.v.resize(n, rows), out.effort_command.resize(n, rows);
  for (int k = 0; k < rows; ++k) {
    reference.At(k / kRate, &q, &v, &a);
    dynamics::Rnea(mechanism, workspace, x.q, x.v, a + 60.0 * (q - x.q) + 12.0 * (v - x.v), u);
    out.t[k] = k / kRate;
    for (int j = 0; j < n; ++j) {
      out.q(j, k) = x.q[j] + kPositionNoise * rng.Normal();
      out.v(j, k) = x.v[j] + kVelocityNoise * rng.Normal();
    }
    out.effort_command.col(k) = u;
    const sim::Outcome outcome = simulator.Advance(x, u, 1 / kRate);
    RG_CHECK(outcome.ok()) << outcome.ToString();
  }
  return out;
}

trajectories::ShardSpec PaperShard(const sim::Plant& plant, uint64_t seed) {
  trajectories::ShardSpec spec;
  spec.seed = seed;
  spec.duration_s = 1.0;
  spec.mpc.peak_torque = trajectories::KnownPeakTorques(plant.model());
  VectorXd home = VectorXd::Zero(plant.num_joints());
  for (int j = 1; j < std::min(3, plant.num_joints()); ++j) home[j] = M_PI;  // the candle pose
  spec.sampling.home = home;
  return spec;
}

policy::Dataset PaperSizedDataset(int joints, uint64_t seed) {
  constexpr int kPoints = 25, kTrajectories = 450;
  Rng rng(seed);
  policy::Dataset dataset;
  for (int trajectory = 0; trajectory < kTrajectories; ++trajectory) {
    MatrixXd q(joints, kPoints), v(joints, kPoints), u(joints, kPoints);
    VectorXd start(joints), goal(joints);
    for (int j = 0; j < joints; ++j)
      start[j] = rng.Uniform(-2.0, 2.0), goal[j] = start[j] + rng.Uniform(-0.4, 0.4);
    for (int k = 0; k < kPoints; ++k) {
      const double s = k / 24.0, shape = s * s * (3.0 - 2.0 * s), rate = 6.0 * s * (1.0 - s);
      q.col(k) = start + shape * (goal - start);
      v.col(k) = rate * (goal - start);
      for (int j = 0; j < joints; ++j) {
        u(j, k) = 8.0 * (goal[j] - q(j, k)) - 2.0 * v(j, k) +
                  5.0 * std::sin(q(j, k) + 0.5 * q((j + 1) % joints, k)) + 0.3 * std::tanh(10.0 * v(j, k));
      }
    }
    dataset.AddTrajectory(static_cast<uint64_t>(trajectory), q, v, goal, u);
  }
  return dataset;
}

}  // namespace rg::lab
