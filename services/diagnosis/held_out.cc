#include "services/diagnosis/held_out.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

namespace rg::diagnosis {

using Eigen::MatrixXd;
using Eigen::VectorXd;

namespace {

constexpr int kIterations = 3;         // of the restarts alone
constexpr double kWorthATry = 1.0;     // nats
constexpr double kOnePercent = 2.326;  // stddev that one of a hundred normal variables exceeds

// Information and gradient of the held-out rows, in units of the parameters' priors, and what was known
// before.
struct Learned {
  MatrixXd before, after;  // P × P
  VectorXd gradient;       // P
};

Learned LearnedFrom(const FitData& held_out, const Candidate& c, const NodeStates& states,
                    const LiftedOptions& options) {
  const auto P = static_cast<long>(c.parameters.size());
  FeatureBlock none;
  std::vector<VectorXd> no_rule;
  for (const NodeWindow& window : held_out.windows) {
    none.phi.emplace_back(0, static_cast<long>(window.t.size()) - 1);
    const auto nodes = std::count(window.measured.begin(), window.measured.end(), char{1});
    no_rule.push_back(VectorXd::Zero(nodes * held_out.n * (held_out.use_velocity ? 2 : 1)));
  }
  const Screen screen = MakeScreen(held_out, FitModel{*c.plant, c.fit.values, c.parameters}, states, none,
                                   options, no_rule, 0, Rng(1));
  VectorXd sigma(P);
  for (long i = 0; i < P; ++i) sigma[i] = c.parameters[static_cast<size_t>(i)].prior_stddev;
  Learned out;
  out.before = MatrixXd::Identity(P, P) + sigma.asDiagonal() * c.fit.information * sigma.asDiagonal();
  out.after = out.before + sigma.asDiagonal() * screen.gram.topLeftCorner(P, P) * sigma.asDiagonal();
  out.gradient = sigma.cwiseProduct(screen.gram.col(P).head(P));
  return out;
}

FitResult Restarted(const FitData& held_out, const Candidate& c, const VectorXd& values,
                    const LiftedOptions& options) {
  return Fit(held_out, FitModel{*c.plant, values, {}}, options);
}

}  // namespace

HeldOut Predicted(const FitData& held_out, const Candidate& fitted, const LiftedOptions& options) {
  LiftedOptions restarts = options;
  restarts.iterations = kIterations, restarts.more_iterations = 0, restarts.free_hidden = false;
  const FitResult fit = Restarted(held_out, fitted, fitted.fit.values, restarts);
  const auto P = static_cast<long>(fitted.parameters.size());
  HeldOut out;
  out.work = fit.work + Work(held_out.Rows(), static_cast<int>(P));
  for (const double chi2 : fit.window_chi2) out.windows.push_back(-0.5 * chi2 / options.noise_scale);
  const double misfit = 0.5 * fit.chi2 / options.noise_scale;
  out.log_density = -misfit;
  const double free =
      std::max(0.0, held_out.Rows() - 2.0 * held_out.n * static_cast<double>(held_out.windows.size()));
  out.scatter = std::sqrt(0.5 * free);
  if (fit.ok && P > 0 && fitted.fit.information.rows() == P) {
    const Learned learned = LearnedFrom(held_out, fitted, fit.states, restarts);
    const Eigen::LLT<MatrixXd> before(learned.before), after(learned.after);
    if (before.info() == Eigen::Success && after.info() == Eigen::Success) {
      for (long i = 0; i < P; ++i)
        out.log_density += std::log(before.matrixLLT()(i, i)) - std::log(after.matrixLLT()(i, i));
      const VectorXd step = after.solve(learned.gradient);
      // What the held-out rows would gain by the parameters that they want, simulated: what is linear where
      // windows run away promises anything.
      if (0.5 * step.dot(learned.gradient) > kWorthATry) {
        VectorXd theta = fitted.fit.theta;
        for (long i = 0; i < P; ++i) {
          const sysid::FitParameter& p = fitted.parameters[static_cast<size_t>(i)];
          theta[i] = std::clamp(theta[i] + p.prior_stddev * step[i], p.lower, p.upper);
        }
        const FitResult moved = Restarted(
            held_out, fitted, sysid::WithFitted(fitted.parameters, fitted.fit.values, theta), restarts);
        const double paid = 0.5 * step.dot(learned.before * step);
        if (moved.ok)
          out.log_density += std::max(0.0, misfit - 0.5 * moved.chi2 / options.noise_scale - paid);
        out.work += moved.work;
      }
    }
  }
  out.short_of_noise = -0.5 * free - out.log_density;
  return out;
}

bool PredictsMore(const HeldOut& a, const HeldOut& b) {
  double wins = 0;
  for (size_t w = 0; w < a.windows.size(); ++w) {
    wins += a.windows[w] > b.windows[w] ? 1.0 : a.windows[w] == b.windows[w] ? 0.5 : 0.0;
  }
  const auto W = static_cast<double>(a.windows.size());
  return wins > 0.5 * W + kOnePercent * 0.5 * std::sqrt(W);
}

}  // namespace rg::diagnosis
