#include "services/diagnosis/jumps.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "services/diagnosis/lineariser.h"
#include "services/diagnosis/loose_start.h"
#include "services/sysid/parallel.h"

namespace rg::diagnosis {

using Eigen::MatrixXd;
using Eigen::VectorXd;

namespace {

constexpr double kMeet = 1e-6;       // s between two windows that meet
constexpr double kSingular = 1e-12;  // of the largest, that a covariance has of its own

// What a window alone knows of its hidden states.
struct Ends {
  VectorXd start, end;
  MatrixXd start_covariance, end_covariance;
  bool ok = false;
};

// Inverse of a precision whose states have units of their own.
MatrixXd Inverse(const MatrixXd& precision) {
  const VectorXd scale = precision.diagonal().cwiseSqrt().cwiseMax(1e-300).cwiseInverse();
  MatrixXd scaled = scale.asDiagonal() * precision * scale.asDiagonal();
  scaled.diagonal().array() += kSingular;
  return scale.asDiagonal() * scaled.ldlt().solve(MatrixXd::Identity(scaled.rows(), scaled.cols())) *
         scale.asDiagonal();
}

Ends EndsOf(Lineariser& lin, int worker, int window, long first, MatrixXd states, const LooseStart& loose,
            double noise_scale) {
  Ends out;
  lin.Simulate(worker, window, &states);
  Linear linear;
  lin.Run(worker, window, states, nullptr, nullptr, true, &linear);
  if (!linear.ok || !states.allFinite()) return out;
  MatrixXd precision = linear.J_e.transpose() * linear.J_e / noise_scale;
  precision.diagonal() += loose.precision;
  const MatrixXd covariance = Inverse(precision);
  const MatrixXd to_end = linear.E.back().rightCols(precision.cols());
  const auto hidden = Eigen::seq(first, Eigen::last);
  out.start = states.col(0)(hidden), out.end = states.col(states.cols() - 1)(hidden);
  out.start_covariance = covariance(hidden, hidden);
  out.end_covariance = MatrixXd(to_end * covariance * to_end.transpose())(hidden, hidden);
  out.ok = out.start_covariance.allFinite() && out.end_covariance.allFinite();
  return out;
}

}  // namespace

FitResult WithJumps(const FitData& data, const sim::Plant& plant, FitResult fit,
                    const LiftedOptions& options) {
  const int W = static_cast<int>(data.windows.size());
  Lineariser lin(data, FitModel{plant, fit.values, {}}, false, options);
  const std::vector<LooseStart> loose = LooseStarts(plant, fit.states);
  std::vector<Ends> ends(static_cast<size_t>(W));
  sysid::ParallelFor(options.threads, W, [&](int worker, int w) {
    const auto i = static_cast<size_t>(w);
    ends[i] = EndsOf(lin, worker, w, 2L * data.n, fit.states[i], loose[i], options.noise_scale);
  });
  fit.work += Work(data.Rows(), lin.nx());
  for (size_t w = 1; w < ends.size(); ++w) {
    const NodeWindow &before = data.windows[w - 1], &window = data.windows[w];
    const bool meet =
        before.recording == window.recording && std::abs(window.t.front() - before.t.back()) < kMeet;
    if (!meet || !ends[w].ok || !ends[w - 1].ok) continue;
    const VectorXd step = ends[w].start - ends[w - 1].end;
    const double nats = 0.5 * step.dot(Inverse(ends[w - 1].end_covariance + ends[w].start_covariance) * step);
    fit.chi2 += 2 * nats * options.noise_scale, fit.window_chi2[w] += 2 * nats * options.noise_scale;
    fit.evidence -= nats;
  }
  return fit;
}

}  // namespace rg::diagnosis
