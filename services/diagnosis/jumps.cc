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

constexpr double kInstant = 1e-6;    // s
constexpr double kSingular = 1e-12;  // of the largest, that a covariance has of its own

// Those of a mass in springs among a plant's states.
std::vector<long> MassStates(const sim::Plant& plant) {
  std::vector<long> out;
  const auto& names = plant.internal_state_names();
  for (size_t i = 0; i < names.size(); ++i) {
    if (names[i].find(".slosh_") != std::string::npos)
      out.push_back(2L * plant.num_joints() + static_cast<long>(i));
  }
  return out;
}

// The window with a node at `t`, where nothing is measured.
void ContinueTo(double t, NodeWindow* window) {
  const long k = window->q.cols();
  for (MatrixXd* m : {&window->q, &window->v, &window->q_stddev, &window->v_stddev, &window->q_row,
                      &window->v_row, &window->q0, &window->v0}) {
    m->conservativeResize(Eigen::NoChange, k + 1);
    m->col(k) = MatrixXd(m->col(k - 1));
  }
  window->t.push_back(t), window->measured.push_back(0);
  window->before.emplace_back(), window->after.emplace_back();
}

// `data` with windows that end where the next begins: their nodes need not divide a window's rows.
FitData Meeting(const FitData& data) {
  FitData out = data;
  for (size_t w = 1; w < out.windows.size(); ++w) {
    NodeWindow& before = out.windows[w - 1];
    const double t = out.windows[w].t.front();
    if (FollowsOn(before, out.windows[w]) && t > before.t.back() + kInstant) ContinueTo(t, &before);
  }
  return out;
}

// What a window alone knows of the mass.
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

Ends EndsOf(Lineariser& lin, int worker, int window, const std::vector<long>& mass, MatrixXd states,
            const LooseStart& loose, double noise_scale) {
  Ends out;
  lin.Simulate(worker, window, &states);
  Linear linear;
  lin.Run(worker, window, states, nullptr, nullptr, true, &linear);
  if (!linear.ok || !states.allFinite()) return out;
  MatrixXd precision = linear.J_e.transpose() * linear.J_e / noise_scale;
  precision.diagonal() += loose.precision;
  const MatrixXd covariance = Inverse(precision);
  const MatrixXd to_end = linear.E.back().rightCols(precision.cols());
  out.start = states.col(0)(mass), out.end = states.col(states.cols() - 1)(mass);
  out.start_covariance = covariance(mass, mass);
  out.end_covariance = MatrixXd(to_end * covariance * to_end.transpose())(mass, mass);
  out.ok = out.start_covariance.allFinite() && out.end_covariance.allFinite();
  return out;
}

}  // namespace

FitResult WithJumps(const FitData& data, const sim::Plant& plant, FitResult fit,
                    const LiftedOptions& options) {
  const FitData meeting = Meeting(data);
  const std::vector<long> mass = MassStates(plant);
  Lineariser lin(meeting, FitModel{plant, fit.values, {}}, false, options);
  const std::vector<LooseStart> loose = LooseStarts(plant, fit.states);
  std::vector<Ends> ends(data.windows.size());
  sysid::ParallelFor(options.threads, static_cast<int>(ends.size()), [&](int worker, int w) {
    const auto i = static_cast<size_t>(w);
    ends[i] = EndsOf(lin, worker, w, mass, fit.states[i], loose[i], options.noise_scale);
  });
  fit.work += Work(data, options, lin.nx(), lin.nx());
  for (size_t w = 1; w < ends.size(); ++w) {
    const bool meet = FollowsOn(data.windows[w - 1], data.windows[w]);
    if (!meet || !ends[w].ok || !ends[w - 1].ok) continue;
    const VectorXd step = ends[w].start - ends[w - 1].end;
    const double nats = 0.5 * step.dot(Inverse(ends[w - 1].end_covariance + ends[w].start_covariance) * step);
    if (!(nats >= 0) || !std::isfinite(nats)) {  // a mass thrown beyond what numbers hold
      fit.ok = false;
      continue;
    }
    fit.chi2 += 2 * nats * options.noise_scale, fit.window_chi2[w] += 2 * nats * options.noise_scale;
    fit.evidence -= nats;
  }
  return fit;
}

double TrueJumps(const FitData& data, const sim::Plant& plant, double noise_scale) {
  double meetings = 0;
  for (size_t w = 1; w < data.windows.size(); ++w)
    meetings += FollowsOn(data.windows[w - 1], data.windows[w]);
  return meetings * static_cast<double>(MassStates(plant).size()) * noise_scale;
}

}  // namespace rg::diagnosis
