#include "services/sysid/shooting_fit.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

namespace rg::sysid {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr double kMinPosition = 1e-6, kMinVelocity = 1e-5;
constexpr double kMaxInflation = 400.0;
constexpr double kMaxBroken = 0.2;    // share of windows
constexpr double kMuchSmaller = 0.7;  // of a joint's scale
constexpr double kStepNoise = 0.2, kStepShare = 0.02;
constexpr int kStepWindows = 40;

class Fitter {
 public:
  Fitter(const sim::Plant& plant, const FitSpace& space, const std::vector<FitRecording>& recordings,
         const recordings::SensorNoise& noise, const ShootingFitOptions& options, const StopCondition& stop,
         const ProgressFn& progress)
      : plant_(plant),
        space_(space),
        recordings_(recordings),
        noise_(noise),
        options_(options),
        stop_(stop),
        progress_(progress) {}

  // False: nothing was done; `fit` is as it was.
  bool Round(double window_s, int max_windows, double inflation, ShootingFit* fit) const {
    if (stop_.ShouldStop()) return false;
    const RecordingShootingOptions shooting = ShootingFor(window_s, max_windows);
    RecordingShooting probe(plant_, fit->values, space_, recordings_, fit->scales, shooting,
                            options_.threads);
    ShootingOptions look;
    look.max_iterations = 0;
    look.threads = options_.threads;
    const auto seen = SolveShooting(ShootingProblemFor(&probe, space_), fit->theta, {}, look, stop_);
    if (seen.residuals.empty() || seen.failed_windows > kMaxBroken * probe.num_windows()) return false;
    return Solve(shooting, Rescaled(probe, seen, inflation, fit->scales), fit);
  }

 private:
  RecordingShootingOptions ShootingFor(double window_s, int max_windows) const {
    RecordingShootingOptions shooting;
    shooting.window_s = window_s;
    shooting.residual_rate_hz = std::max(options_.residual_rate_hz, 4.0 / window_s);
    shooting.use_velocity = options_.use_velocity;
    shooting.max_windows = max_windows;
    shooting.internal_state_stddev = options_.internal_state_stddev;
    shooting.simulator = options_.simulator;
    return shooting;
  }

  ShootingScales Rescaled(const RecordingShooting& model, const ShootingSolution& seen, double inflation,
                          ShootingScales scales) const {
    VectorXd position, velocity;
    model.ResidualSpread(seen.residuals, &position, &velocity);
    scales.position = position.cwiseMax(noise_.position_stddev) * std::sqrt(inflation);
    if (velocity.size() > 0) {
      scales.velocity = velocity.cwiseMax(noise_.velocity_stddev) * std::sqrt(inflation);
    }
    return scales;
  }

  bool Solve(const RecordingShootingOptions& shooting, const ShootingScales& scales, ShootingFit* fit) const {
    RecordingShooting model(plant_, fit->values, space_, recordings_, scales, shooting, options_.threads);
    ShootingOptions solver;
    solver.huber = options_.huber;
    solver.threads = options_.threads;
    solver.max_iterations = options_.max_iterations;
    solver.relative_tolerance = options_.relative_tolerance;
    ShootingSolution solution = SolveShooting(
        ShootingProblemFor(&model, space_), fit->theta, {}, solver, stop_, [&](int iteration, double cost) {
          if (progress_) {
            progress_({"shooting", static_cast<double>(iteration),
                       static_cast<double>(options_.max_iterations), "cost " + std::to_string(cost)});
          }
        });
    if (solution.information.isZero(0.0)) return false;  // stopped before the first linearisation
    fit->solution = std::move(solution);
    fit->scales = scales;
    fit->window_s = shooting.window_s;
    fit->theta = fit->solution.theta;
    fit->values = space_.Values(fit->theta, fit->values);
    return true;
  }

  const sim::Plant& plant_;
  const FitSpace& space_;
  const std::vector<FitRecording>& recordings_;
  const recordings::SensorNoise& noise_;
  const ShootingFitOptions& options_;
  const StopCondition& stop_;
  const ProgressFn& progress_;
};

// Position residuals of both against each other: true when the coarse step is fine enough.
bool StepIsFine(RecordingShooting* coarse, RecordingShooting* fine, const VectorXd& theta) {
  double difference = 0.0, residual = 0.0, count = 0.0;
  for (int w = 0; w < coarse->num_windows(); ++w) {
    VectorXd a(coarse->window_residuals(w)), b(a.size());
    const VectorXd xi = VectorXd::Zero(coarse->window_unknowns(w));
    if (!fine->Evaluate(0, w, theta, xi, &b, nullptr, nullptr)) continue;
    if (!coarse->Evaluate(0, w, theta, xi, &a, nullptr, nullptr)) return false;
    difference += (a - b).squaredNorm();
    residual += b.squaredNorm();
    count += static_cast<double>(b.size());
  }
  return difference <= std::max(kStepNoise * kStepNoise * count, kStepShare * kStepShare * residual);
}

bool MuchSmaller(const ShootingScales& scales, const ShootingScales& before) {
  return (scales.position.array().log() - before.position.array().log()).minCoeff() < std::log(kMuchSmaller);
}

}  // namespace

recordings::SensorNoise FlooredNoise(recordings::SensorNoise noise) {
  noise.position_stddev = noise.position_stddev.cwiseMax(kMinPosition);
  noise.velocity_stddev = noise.velocity_stddev.cwiseMax(kMinVelocity);
  return noise;
}

ShootingFit FitByShooting(const sim::Plant& plant, const VectorXd& values, const FitSpace& space,
                          const VectorXd& theta, const std::vector<FitRecording>& recordings,
                          const recordings::SensorNoise& noise, const ShootingFitOptions& options,
                          const StopCondition& stop,
                          const std::function<void(const ShootingFit&)>& after_round,
                          const ProgressFn& progress) {
  const recordings::SensorNoise floored = FlooredNoise(noise);
  const Fitter fitter(plant, space, recordings, floored, options, stop, progress);
  ShootingFit fit{theta, space.Values(theta, values), {}, ScalesOf(floored), 0.0};
  if (!fitter.Round(options.first_window_s, options.first_max_windows, 1.0, &fit)) return fit;
  if (after_round) after_round(fit);
  const double inflation = std::clamp(fit.solution.variance_inflation, 1.0, kMaxInflation);
  for (int round = 0; round <= options.refinements; ++round) {
    const ShootingScales before = fit.scales;
    if (!fitter.Round(options.window_s, std::numeric_limits<int>::max(), round == 0 ? inflation : 1.0, &fit))
      break;
    if (after_round) after_round(fit);
    if (round > 0 && !MuchSmaller(fit.scales, before)) break;
  }
  return fit;
}

void AddInformation(const sim::Plant& plant, const FitSpace& space,
                    const std::vector<FitRecording>& recordings, const recordings::SensorNoise& noise,
                    const ShootingFitOptions& options, const StopCondition& stop, ShootingFit* fit) {
  if (space.size() == 0) return;
  ShootingFitOptions look = options;
  look.max_iterations = 0;
  const VectorXd theta = fit->theta, values = fit->values;
  const ProgressFn silent;
  Fitter(plant, space, recordings, FlooredNoise(noise), look, stop, silent)
      .Round(options.window_s, std::numeric_limits<int>::max(), 1.0, fit);
  fit->theta = theta;
  fit->values = values;
}

IdentifiabilityReport IdentifiabilityOf(const FitSpace& space, const ShootingFit& fit) {
  const int P = space.size();
  if (P == 0 || fit.solution.information.rows() != P) return {};
  IdentifiabilityInput in = IdentifiabilityInputOf(space, fit.theta, fit.solution.information);
  in.residual_variance = std::clamp(fit.solution.variance_inflation, 1.0, kMaxInflation);
  return Identify(in);
}

IdentifiabilityInput IdentifiabilityInputOf(const FitSpace& space, const VectorXd& theta,
                                            const MatrixXd& information) {
  const int P = space.size();
  const MatrixXd dp_dtheta = space.Jacobian(theta);
  const MatrixXd dtheta_dp = dp_dtheta.inverse();
  IdentifiabilityInput in;
  in.value = space.Parameters(theta);
  in.prior_stddev = (dp_dtheta * space.prior_stddev().asDiagonal()).rowwise().norm();
  for (VectorXd* v : {&in.nominal, &in.lower, &in.upper}) v->resize(P);
  for (int i = 0; i < P; ++i) {
    const FitParameter& p = space.parameters()[i];
    in.names.push_back(p.name);
    in.units.push_back(p.unit);
    in.nominal[i] = p.nominal;
    in.lower[i] = space.IsItself(i) ? space.lower()[i] : -std::numeric_limits<double>::infinity();
    in.upper[i] = space.IsItself(i) ? space.upper()[i] : std::numeric_limits<double>::infinity();
  }
  in.information = dtheta_dp.transpose() * information * dtheta_dp;
  return in;
}

double ChooseStep(const sim::Plant& plant, const VectorXd& values, const FitSpace& space,
                  const VectorXd& theta, const std::vector<FitRecording>& recordings,
                  const recordings::SensorNoise& noise, double window_s) {
  RecordingShootingOptions options;
  options.window_s = window_s;
  options.use_velocity = false;
  options.max_windows = kStepWindows;
  const ShootingScales scales = ScalesOf(FlooredNoise(noise));
  double step = 8e-3;
  for (; step > 1e-3; step *= 0.5) {
    options.simulator.step_s = step;
    RecordingShooting coarse(plant, values, space, recordings, scales, options, 1);
    options.simulator.step_s = 0.5 * step;
    RecordingShooting fine(plant, values, space, recordings, scales, options, 1);
    if (StepIsFine(&coarse, &fine, theta)) break;
  }
  return step;
}

}  // namespace rg::sysid
