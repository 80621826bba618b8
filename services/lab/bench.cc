#include "services/lab/bench.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "common/base/parallel.h"
#include "common/base/printf.h"
#include "common/base/rng.h"
#include "common/dynamics/dynamics.h"
#include "common/model/robot_model.h"
#include "services/lab/subjects.h"
#include "services/policy/train.h"
#include "services/sysid/drive_signal.h"
#include "services/sysid/recording_shooting.h"
#include "services/sysid/shooting_fit.h"
#include "services/trajectories/mpc_controller.h"

namespace rg::lab {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr double kMicro = 1e6, kMilli = 1e3;

class Bench {
 public:
  Bench(std::shared_ptr<const model::RobotModel> robot, const BenchOptions& options, const Clock& clock,
        const CancelToken* cancel)
      : robot_(std::move(robot)), options_(options), clock_(clock), cancel_(cancel) {}

  Measurement Measure(const std::string& key);

 private:
  int Batches(int full, int quick) const { return options_.quick ? quick : full; }
  Measurement RigidBody(const std::string& key);
  Measurement StepSensitivities(bool lanes);
  Measurement EffectsRatio();
  Measurement Jacobian();
  Measurement Identify();
  Measurement GnmsIteration();
  Measurement OneTrajectory();
  Measurement AllTrajectories();
  Measurement Training();
  Measurement Iteration();

  std::shared_ptr<const model::RobotModel> robot_;
  const BenchOptions& options_;
  const Clock& clock_;
  const CancelToken* cancel_;
};

Measurement Done(double value, int samples, std::string note) {
  Measurement m;
  m.value = value, m.samples = samples, m.note = std::move(note);
  return m;
}
Measurement Failed(std::string note) {
  Measurement m;
  m.note = std::move(note);
  return m;
}

VectorXd Draw(Rng& rng, int n, double size) {
  VectorXd x(n);
  for (int i = 0; i < n; ++i) x[i] = rng.Uniform(-size, size);
  return x;
}

Measurement Bench::RigidBody(const std::string& key) {
  const int n = robot_->num_joints();
  const dynamics::Mechanism mechanism(*robot_);
  dynamics::Workspace w;
  Rng rng(options_.seed);
  VectorXd q = Draw(rng, n, 3), out(n);
  const VectorXd v = Draw(rng, n, 1), a = Draw(rng, n, 3), tau = Draw(rng, n, 5);
  MatrixXd dq(n, n), dv(n, n), dtau(n, n), Y(n, 10 * n);
  int samples = 0;
  // The last result's bits enter the next input, as in a simulation, so that calls wait for each other.
  const auto per_call = [&](const auto& call) {
    return kMicro * SecondsPerCall([&] { call(), q[0] += 1e-30 * out[0]; }, Batches(301, 31), &samples);
  };
  double us = 0;
  if (key == "rnea_us") {
    us = per_call([&] { dynamics::Rnea(mechanism, w, q, v, a, out); });
  } else if (key == "aba_us") {
    us = per_call([&] { dynamics::Aba(mechanism, w, q, v, tau, out); });
  } else if (key == "aba_derivatives_us") {
    us = per_call([&] { dynamics::AbaDerivatives(mechanism, w, q, v, tau, out, dq, dv, dtau); });
  } else {
    out.setZero();
    us = per_call([&] { dynamics::TorqueRegressor(mechanism, w, q, v, a, Y), out[0] = Y(0, 0); });
  }
  return Done(us, samples, "one lane, " + std::string(math::IsaName(math::DetectIsa())) + ", CPU time");
}

std::string Count(size_t parameters) { return std::to_string(parameters) + " parameters"; }

Measurement Bench::StepSensitivities(bool lanes) {
  int samples = 0;
  if (lanes) {
    constexpr double kSeconds = 8.0;
    MovingArm arm(robot_, {}, kSeconds);
    const int count = 8;
    if (!arm.CutIntoWindows(count) || !arm.SimulateSideBySide()) return Failed("the motion broke down");
    const double s = SecondsPerCall([&] { arm.SimulateSideBySide(); }, Batches(31, 5), &samples);
    return Done(kMicro * s / (kSeconds * 1000), samples,
                "leapfrog at 1 ms, " + Count(arm.parameters.size()) + ", eight windows of 1 s, " +
                    std::to_string(arm.simulator.lanes()) +
                    " side by side on one core, per window and step, "
                    "CPU time");
  }
  constexpr double kSeconds = 1.0;
  MovingArm arm(robot_, {}, kSeconds);
  if (!arm.SimulateWithSensitivities()) return Failed(arm.out.outcome.ToString());
  const double s = SecondsPerCall([&] { arm.SimulateWithSensitivities(); }, Batches(101, 11), &samples);
  return Done(kMicro * s / (kSeconds * 1000), samples,
              "leapfrog (second order) at 1 ms, " + Count(arm.parameters.size()) + ", one lane, CPU time");
}

Measurement Bench::EffectsRatio() {
  std::vector<std::string> joints;
  for (const model::Joint& joint : robot_->joints()) joints.push_back(joint.name);
  MovingArm rigid(robot_, {}, 1.0), rich(robot_, FrictionElasticityLagDelay(joints), 1.0);
  if (!rich.SimulateWithSensitivities()) return Failed(rich.out.outcome.ToString());
  int samples = 0;
  // Measured in turns, so that both see the same machine.
  std::vector<double> ratios;
  for (int round = 0; round < Batches(31, 5); ++round) {
    const double a = SecondsPerCall([&] { rigid.SimulateWithSensitivities(); }, 1, &samples);
    ratios.push_back(SecondsPerCall([&] { rich.SimulateWithSensitivities(); }, 1, &samples) / a);
  }
  return Done(Median(ratios), static_cast<int>(ratios.size()),
              "Coulomb friction, elasticity 1e4 N·m/rad, lag 10 ms, delay 5 ms on every joint against none, "
              "both with sensitivities to " +
                  Count(rich.parameters.size()));
}

// What identifying the paper's parameters from a recording of 8 s works on.
struct EightSeconds {
  EightSeconds(const MovingArm& arm, uint64_t seed)
      : recording(RecordMotion(arm.plant, arm.values, 8.0, seed)),
        space(ParametersOf(arm), false),
        fit{{&recording, sysid::DriveSignal(recording)}} {
    const int n = arm.plant.num_joints();
    noise = {VectorXd::Constant(n, kPositionNoise), VectorXd::Constant(n, kVelocityNoise), VectorXd::Zero(n)};
  }
  static std::vector<sysid::FitParameter> ParametersOf(const MovingArm& arm) {
    std::vector<std::string> names;
    for (const int i : arm.parameters) names.push_back(arm.plant.parameters()[i].name);
    return *sysid::NamedFitParameters(arm.plant, names);
  }
  VectorXd Theta(const VectorXd& values) const {
    VectorXd theta(space.size());
    for (int i = 0; i < theta.size(); ++i)
      theta[i] = values[space.parameters()[static_cast<size_t>(i)].index];
    return theta;
  }
  EightSeconds(const EightSeconds&) = delete;  // `fit` points to the recording

  recordings::Recording recording;
  sysid::FitSpace space;
  recordings::SensorNoise noise;
  std::vector<sysid::FitRecording> fit;
};

// As identification linearises it: all windows at once, by the parameters and each window's initial state.
Measurement Bench::Jacobian() {
  MovingArm arm(robot_, {}, 8.0);
  const EightSeconds data(arm, options_.seed);
  sysid::RecordingShooting model(arm.plant, arm.values, data.space, data.fit, sysid::ScalesOf(data.noise), {},
                                 1);
  const auto count = static_cast<size_t>(model.num_windows());
  const VectorXd theta = data.Theta(arm.values);
  std::vector<VectorXd> xi(count), r(count);
  std::vector<sysid::RowMatrix> by_theta(count), by_xi(count);
  std::vector<sysid::ShootingModel::Evaluation> windows(count);
  size_t numbers = 0;
  for (size_t w = 0; w < count; ++w) {
    const int rows = model.window_residuals(static_cast<int>(w));
    const int unknowns = model.window_unknowns(static_cast<int>(w));
    xi[w] = VectorXd::Zero(unknowns);
    r[w].resize(rows), by_theta[w].resize(rows, theta.size()), by_xi[w].resize(rows, unknowns);
    windows[w] = {.window = static_cast<int>(w),
                  .xi = &xi[w],
                  .r = &r[w],
                  .dr_dtheta = &by_theta[w],
                  .dr_dxi = &by_xi[w]};
    numbers += static_cast<size_t>(by_theta[w].size() + by_xi[w].size());
  }
  int samples = 0, alone_samples = 0;
  const double s = SecondsPerCall([&] { model.EvaluateMany(0, theta, &windows); }, Batches(31, 5), &samples);
  for (const auto& window : windows) {
    if (!window.ok) return Failed("the motion broke down");
  }
  if (!arm.SimulateWithSensitivities()) return Failed(arm.out.outcome.ToString());
  const double alone =
      SecondsPerCall([&] { arm.SimulateWithSensitivities(); }, Batches(31, 5), &alone_samples);
  char note[400];
    std::snprintf(note, sizeof note,
      "residuals of 8 s at 1 ms steps by %zu parameters and the initial states of %zu windows of 1 s, "
      "rows at 25 Hz (%.1f MB), as identification evaluates them: %d windows side by side on one "
      "core, CPU time; in one run over all 8 s, which has one lane: %.1f ms",
      arm.parameters.size(), count, 8e-6 * static_cast<double>(numbers), model.side_by_side(),
      kMilli * alone);
  return Done(kMilli * s, samples, note);
}

// The whole table within ±20 % where the paper's parameters are, each at one end or the other.
VectorXd TwentyPercentOff(const sim::Plant& plant, VectorXd values, uint64_t seed) {
  Rng rng(seed);
  for (const int i : sim::PaperParameters(plant)) values[i] *= rng.Uniform(0, 1) < 0.5 ? 0.8 : 1.2;
  return values;
}

double RootMeanSquare(const std::vector<VectorXd>& residuals) {
  double sum = 0, count = 0;
  for (const VectorXd& r : residuals) sum += r.squaredNorm(), count += static_cast<double>(r.size());
  return std::sqrt(sum / count);
}

Measurement Bench::Identify() {
  const MovingArm arm(robot_, {}, 0.2);
  const sim::Plant& plant = arm.plant;
  const EightSeconds data(arm, options_.seed);
  const VectorXd start = TwentyPercentOff(plant, arm.values, options_.seed + 2);
  sysid::ShootingFitOptions options;
  options.threads = options_.threads;
  options.simulator.step_s = 2e-3;
  options.relative_tolerance = 1e-5;
  options.max_iterations = 30;
  std::vector<double> seconds;
  sysid::ShootingFit result;
  for (int round = 0; round < Batches(3, 1); ++round) {
    const double begin = clock_.SteadySeconds();
    result = sysid::FitByShooting(plant, start, data.space, data.Theta(start), data.fit, data.noise, options,
                                  sysid::StopCondition(cancel_));
    seconds.push_back(clock_.SteadySeconds() - begin);
  }
  char note[400];
    std::snprintf(note, sizeof note,
      "multiple shooting over the whole 8 s (100 Hz, noise 3e-4 rad), %d parameters from ±20 %% off, "
      "step 2 ms, %d threads, wall time; ended %s after %d iterations in windows of %.2g s, residuals "
      "%.3g of the noise",
      data.space.size(), options_.threads,
      std::string(sysid::TerminationName(result.solution.termination)).c_str(), result.solution.iterations,
      result.window_s, RootMeanSquare(result.solution.residuals));
  return Done(Median(seconds), static_cast<int>(seconds.size()), note);
}

Measurement Bench::GnmsIteration() {
  const MovingArm arm(robot_, {}, 0.2);
  trajectories::ShardSpec spec = PaperShard(arm.plant, options_.seed);
  spec.mpc.warm_iterations = 1;
  spec.mpc.solver.step_tolerance = 0.0;
  auto controller =
      trajectories::MpcController::Create(arm.plant, arm.plant.parameters().Nominal(), spec.mpc);
  if (!controller.ok()) return Failed(controller.status().ToString());
  Rng rng(options_.seed);
  const VectorXd q = spec.sampling.home, v = VectorXd::Zero(q.size()), goal = q + Draw(rng, q.size(), 0.3);
  VectorXd u;
  (*controller)->Solve(q, v, goal, &u);
  int samples = 0, iterations = 0;
  const double s = SecondsPerCall([&] { iterations = (*controller)->Solve(q, v, goal, &u).iterations; },
                                  Batches(101, 11), &samples);
  return Done(kMilli * s / std::max(1, iterations), samples,
              "25 knots over 1 s, leapfrog at 10 ms (errs less over 40 ms than 1 ms Euler), CPU time");
}

Measurement Bench::OneTrajectory() {
  const MovingArm arm(robot_, {}, 0.2);
  trajectories::ShardSpec spec = PaperShard(arm.plant, options_.seed);
  spec.count = 1;
  const ThreadCpuClock cpu;
  std::vector<double> seconds;
  for (int slot = 0; slot < Batches(60, 10); ++slot, ++spec.first) {
    const double begin = cpu.SteadySeconds();
    const auto shard = trajectories::GenerateShard(arm.plant, arm.plant.parameters().Nominal(), spec);
    if (!shard.ok()) return Failed(shard.status().ToString());
    seconds.push_back(cpu.SteadySeconds() - begin);
  }
  return Done(
      kMilli * Median(seconds), static_cast<int>(seconds.size()),
      "receding horizon, a cold solve and 24 warm steps, 10 ms leapfrog, random start and goal, CPU time");
}

Measurement Bench::AllTrajectories() {
  const MovingArm arm(robot_, {}, 0.2);
  const int count = options_.quick ? 60 : 450, threads = std::max(1, options_.threads);
  const VectorXd values = arm.plant.parameters().Nominal();
  std::vector<Status> ends(static_cast<size_t>(threads), Status::Ok());
  const double begin = clock_.SteadySeconds();
  ParallelFor(threads, threads, [&](int, int t) {
    trajectories::ShardSpec spec = PaperShard(arm.plant, options_.seed);
    spec.first = static_cast<uint64_t>(count * t / threads);
    spec.count = static_cast<uint32_t>(count * (t + 1) / threads - count * t / threads);
    ends[static_cast<size_t>(t)] = trajectories::GenerateShard(arm.plant, values, spec, {}, cancel_).status();
  });
  const double seconds = clock_.SteadySeconds() - begin;
  for (const Status& end : ends) {
    if (!end.ok()) return Failed(end.ToString());
  }
  std::string note = std::to_string(threads) + " threads, wall time";
  if (count != 450) note += "; " + std::to_string(count) + " made, scaled to 450";
  return Done(seconds * 450 / count, 1, note);
}

Measurement Bench::Training() {
  const policy::Dataset dataset = PaperSizedDataset(robot_->num_joints(), options_.seed);
  policy::TrainOptions options;
  options.validation_fraction = 0.0;
  options.epochs = options_.quick ? 10 : 100;
  options.seed = options_.seed;
  const ThreadCpuClock cpu;
  const double begin = cpu.SteadySeconds();
  const auto result = policy::Train(dataset, options, {}, cancel_);
  const double seconds = cpu.SteadySeconds() - begin;
  if (!result.ok()) return Failed(result.status().ToString());
  const std::string note =
      Printf("11,250 points, batch 32, one thread, CPU time; loss %.3g after %d epochs%s", result->train_loss,
             options.epochs, options.epochs == 100 ? "" : ", scaled to 100");
  return Done(seconds * 100 / options.epochs, 1, note);
}

Measurement Bench::Iteration() {
  if (!options_.run_iteration) return Failed("no programs to run an iteration with");
  if (options_.quick) return Failed("left out by --quick; ask for it with --only iteration_s");
  const auto seconds = options_.run_iteration();
  if (!seconds.ok()) return Failed(seconds.status().ToString());
  return Done(*seconds, 1, "realitygrad run: coordinator, workers and agent as programs, wall time");
}

Measurement Bench::Measure(const std::string& key) {
  if (key == "step_sensitivities_us") return StepSensitivities(false);
  if (key == "step_sensitivities_lanes_us") return StepSensitivities(true);
  if (key == "step_effects_ratio") return EffectsRatio();
  if (key == "jacobian_8s_ms") return Jacobian();
  if (key == "identify_8s_s") return Identify();
  if (key == "gnms_iteration_ms") return GnmsIteration();
  if (key == "trajectory_1s_ms") return OneTrajectory();
  if (key == "trajectories_450_s") return AllTrajectories();
  if (key == "training_s") return Training();
  if (key == "iteration_s") return Iteration();
  return RigidBody(key);
}

}  // namespace

const std::vector<Row>& Rows() {
  static const std::vector<Row> rows = {
      {"rnea_us", "inverse dynamics (RNEA)", "µs", 0.70, "Pinocchio 0.70"},
      {"aba_us", "forward dynamics (ABA)", "µs", 1.5, "Pinocchio 1.5"},
      {"aba_derivatives_us", "its analytic derivatives", "µs", 3.4, "Pinocchio 3.4"},
      {"regressor_us", "torque regressor", "µs", 1.25, "Pinocchio 1.25"},
      {"step_sensitivities_us", "1 ms step with 71 sensitivities", "µs", 4.0,
       "Pinocchio 4.8, generated code 4.0"},
      {"step_sensitivities_lanes_us", "  with windows in SIMD lanes", "µs", 2.0, "–"},
      {"step_effects_ratio", "  with effects on, against rigid", "×", 2.0, "–"},
      {"jacobian_8s_ms", "Jacobian of 8 s, 71 parameters", "ms", 20, "Pinocchio 38; the paper's stack 5 GB"},
      {"identify_8s_s", "71 parameters on 8 s, 20 % off", "s", 5, "the paper: 0.2 s in 10 to 60 min"},
      {"gnms_iteration_ms", "GNMS iteration, 25 knots", "ms", 1, "Control Toolbox 18"},
      {"trajectory_1s_ms", "receding-horizon trajectory of 1 s", "ms", 60,
       "Control Toolbox 1370 (1 ms), 41 (RK4)"},
      {"trajectories_450_s", "450 of them", "s", 15, "the paper 77 (30 threads)"},
      {"training_s", "training, 100 epochs", "s", 3, "mlpack 4.4, libtorch 10, the paper 24"},
      {"iteration_s", "one whole iteration", "s", 90, "the paper 1278 (32 cores)"}};
  return rows;
}

Result<std::vector<Measurement>> MeasureRows(
    const std::vector<Row>& rows, const std::vector<std::string>& only,
    const std::function<Measurement(const std::string& key)>& measure, const ProgressFn& progress,
    const CancelToken* cancel) {
  std::vector<std::string> keys;
  for (const Row& row : rows) {
    if (only.empty() || std::count(only.begin(), only.end(), row.key) > 0) keys.push_back(row.key);
  }
  for (const std::string& key : only) {
    if (std::count(keys.begin(), keys.end(), key) == 0)
      return InvalidError("--only: no figure is called '" + key + "'");
  }
  const auto cancelled = [&] { return cancel != nullptr && cancel->cancelled(); };
  std::vector<Measurement> out;
  const auto show = [&](const std::string& key) {
    if (progress) progress({"bench", static_cast<double>(out.size()), static_cast<double>(keys.size()), key});
  };
  for (const std::string& key : keys) {
    if (cancelled()) break;
    show(key);
    out.push_back(measure(key));
    out.back().key = key;
  }
  if (cancelled()) return CancelledError("interrupted");
  show("");
  return out;
}

Result<std::vector<Measurement>> RunBench(std::shared_ptr<const model::RobotModel> robot,
                                          const BenchOptions& options, const Clock& clock,
                                          const ProgressFn& progress, const CancelToken* cancel) {
  BenchOptions chosen = options;
  if (options.run_iteration && options.only == std::vector<std::string>{"iteration_s"})
    chosen.quick = false;  // asked for by name
  Bench bench(std::move(robot), chosen, clock, cancel);
  return MeasureRows(
      Rows(), options.only, [&](const std::string& key) { return bench.Measure(key); }, progress, cancel);
}

nlohmann::json BenchJson(const std::vector<Row>& rows, const std::vector<Measurement>& measurements) {
  nlohmann::json out, notes, samples, targets;
  for (const Measurement& m : measurements) {
    out[m.key] = m.value && std::isfinite(*m.value) ? nlohmann::json(*m.value) : nlohmann::json(nullptr);
    notes[m.key] = m.note;
    samples[m.key] = m.samples;
    for (const Row& row : rows) {
      if (m.key != row.key) continue;
      targets[m.key] = row.target;
      if (row.rival == nullptr) targets[m.key] = {{row.at_least ? "at_least" : "at_most", row.target}};
    }
  }
  out["notes"] = notes, out["samples"] = samples, out["targets"] = targets;
  return out;
}

}  // namespace rg::lab
