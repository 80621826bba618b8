#include "services/proof/black_box.h"

#include <Eigen/Cholesky>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <limits>

#include "common/recordings/noise.h"
#include "common/recordings/windows.h"
#include "common/sim/simulator.h"
#include "services/sysid/drive_signal.h"

namespace rg::proof {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using recordings::Recording;

constexpr int kFeatures = 192, kRowsPerRecording = 800, kDegree = 3;
constexpr double kHalfSpan = 0.05;   // s, of the local cubics; at least three rows to each side
constexpr double kPiece = 0.005;     // s, in prediction
constexpr double kSpeedTrust = 0.1;  // s: position noise over velocity noise of usual encoders
constexpr double kRidge[] = {1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0};

struct Examples {
  MatrixXd state, missing;  // 3n × m, n × m
};

// Value, slope and curvature at t[row] of local cubics through q (and v), and the mean command there.
class LocalCubics {
 public:
  explicit LocalCubics(const Recording& recording) : r_(recording) {
    half_ = std::max(kHalfSpan, 3.2 * recording.SamplePeriod());
  }

  bool At(int row, VectorXd* q, VectorXd* v, VectorXd* a, VectorXd* u) const {
    const double t0 = r_.t[row];
    int first = row, last = row;
    while (first > 0 && r_.t[first - 1] >= t0 - half_) --first;
    while (last + 2 < r_.rows() && r_.t[last + 1] <= t0 + half_) ++last;
    const int m = last - first + 1;
    if (m < kDegree + 3 || t0 - r_.t[0] < half_ || r_.t[r_.rows() - 1] - t0 < half_) return false;
    const int speeds = r_.has_velocity() ? m : 0;
    MatrixXd design(m + speeds, kDegree + 1), held(m, kDegree + 1);
    for (int k = 0; k < m; ++k) {
      const double s = (r_.t[first + k] - t0) / half_,
                   mid = s + 0.5 * (r_.t[first + k + 1] - r_.t[first + k]) / half_;
      design.row(k) << 1, s, s * s, s * s * s;
      held.row(k) << 1, mid, mid * mid, mid * mid * mid;
      if (speeds > 0) design.row(m + k) << 0, 1, 2 * s, 3 * s * s;
      if (speeds > 0) design.row(m + k) *= kSpeedTrust / half_;
    }
    MatrixXd values(m + speeds, r_.n());
    values.topRows(m) = r_.q.middleCols(first, m).transpose();
    if (speeds > 0) values.bottomRows(m) = kSpeedTrust * r_.v.middleCols(first, m).transpose();
    const MatrixXd cubic = design.householderQr().solve(values);
    *q = cubic.row(0).transpose();
    *v = cubic.row(1).transpose() / half_;
    *a = 2 * cubic.row(2).transpose() / (half_ * half_);
    const bool holds = r_.drive == recordings::EffortKind::kCommand;
    const MatrixXd effort = r_.drive_effort().middleCols(first, m).transpose();
    *u = (holds ? held : MatrixXd(design.topRows(m))).householderQr().solve(effort).row(0).transpose();
    return true;
  }

 private:
  const Recording& r_;
  double half_;
};

// What the URDF declares: [damping, friction] of each joint.
MatrixXd Declared(const sim::Plant& plant) {
  MatrixXd out = MatrixXd::Zero(plant.num_joints(), 2);
  const sim::ParameterTable& table = plant.parameters();
  const VectorXd values = table.Nominal();
  for (int j = 0; j < plant.num_joints(); ++j) {
    const int damping = table.Find("damping." + plant.joint_names()[static_cast<size_t>(j)]),
              friction = table.Find("friction." + plant.joint_names()[static_cast<size_t>(j)]);
    if (damping >= 0) out(j, 0) = values[damping];
    if (friction >= 0) out(j, 1) = values[friction];
  }
  return out;
}

Examples ExamplesOf(const sim::Plant& plant, const Recording& recording) {
  const int n = recording.n(), step = std::max(1, recording.rows() / kRowsPerRecording);
  const dynamics::Mechanism mechanism = sysid::MechanismOf(plant, plant.parameters().Nominal());
  const MatrixXd declared = Declared(plant);
  dynamics::Workspace workspace;
  const LocalCubics cubics(recording);
  Examples out{MatrixXd(3 * n, recording.rows() / step + 1), MatrixXd(n, recording.rows() / step + 1)};
  Eigen::Index m = 0;
  VectorXd q, v, a, u, torque(n);
  for (int row = 0; row < recording.rows(); row += step) {
    if (!cubics.At(row, &q, &v, &a, &u)) continue;
    dynamics::Rnea(mechanism, workspace, q, v, a, torque);
    torque += declared.col(0).cwiseProduct(v) + declared.col(1).cwiseProduct(v.cwiseSign());
    out.state.col(m) << q, v, u;
    out.missing.col(m++) = torque - u;
  }
  out.state.conservativeResize(Eigen::NoChange, m);
  out.missing.conservativeResize(Eigen::NoChange, m);
  return out;
}

struct Normal {
  MatrixXd features, with_target;  // ΦᵀΦ, ΦᵀY
  double target = 0;               // |Y|²
  double rows = 0;
  Normal& operator+=(const Normal& o) {
    features += o.features, with_target += o.with_target, target += o.target, rows += o.rows;
    return *this;
  }
};

MatrixXd Ridge(const Normal& all, double strength) {
  MatrixXd system = all.features;
  system.diagonal().array() += strength * all.rows + 1e-9;
  return system.ldlt().solve(all.with_target);
}

double ErrorOf(const Normal& held, const MatrixXd& weights) {
  return held.target - 2 * weights.cwiseProduct(held.with_target).sum() +
         weights.cwiseProduct(held.features * weights).sum();
}

// The ridge whose residual is best on recordings left out; zero weights where none helps there.
MatrixXd BestWeights(const std::vector<Normal>& parts) {
  Normal all = parts[0];
  for (size_t i = 1; i < parts.size(); ++i) all += parts[i];
  double least = all.target, best = std::numeric_limits<double>::infinity();
  for (const double strength : kRidge) {
    double error = 0;
    for (const Normal& held : parts) {
      Normal rest = all;
      rest.features -= held.features, rest.with_target -= held.with_target, rest.rows -= held.rows;
      error += ErrorOf(held, Ridge(rest, strength));
    }
    if (error < least) least = error, best = strength;
  }
  if (!std::isfinite(best)) return MatrixXd::Zero(all.with_target.rows(), all.with_target.cols());
  return Ridge(all, best);
}

}  // namespace

Result<BlackBox> BlackBox::Fit(const sim::Plant& nominal, const recordings::RecordingSet& set, Rng rng) {
  BlackBox box(nominal);
  std::vector<Examples> examples;
  Eigen::Index rows = 0;
  for (const Recording* recording : set.Fit()) {
    Examples one = ExamplesOf(nominal, *recording);
    if (one.state.cols() == 0) continue;
    rows += one.state.cols();
    examples.push_back(std::move(one));
  }
  const int inputs = 3 * nominal.num_joints();
  if (rows < 10 * inputs || examples.size() < 2) return FailedPreconditionError("too little to learn from");
  MatrixXd states(inputs, rows), missing(nominal.num_joints(), rows);
  for (Eigen::Index at = 0; const Examples& e : examples) {
    states.middleCols(at, e.state.cols()) = e.state, missing.middleCols(at, e.state.cols()) = e.missing;
    at += e.state.cols();
  }
  box.mean_ = states.rowwise().mean();
  box.spread_ = ((states.colwise() - box.mean_).rowwise().squaredNorm() / rows).cwiseSqrt().cwiseMax(1e-9);
  box.low_ = (states.rowwise().minCoeff() - box.mean_).cwiseQuotient(box.spread_);
  box.high_ = (states.rowwise().maxCoeff() - box.mean_).cwiseQuotient(box.spread_);
  // The torques of light and heavy joints count alike.
  const VectorXd scale = (missing.rowwise().squaredNorm() / rows).cwiseSqrt().cwiseMax(1e-12);
  box.project_.resize(kFeatures, inputs);
  box.phase_.resize(kFeatures);
  for (int f = 0; f < kFeatures; ++f) {
    for (int i = 0; i < inputs; ++i) box.project_(f, i) = 1.5 * rng.Normal() / std::sqrt(inputs);
    box.phase_[f] = rng.Uniform(-2, 2);
  }
  std::vector<Normal> parts;
  for (const Examples& e : examples) {
    MatrixXd features(1 + inputs + kFeatures, e.state.cols());
    for (Eigen::Index k = 0; k < e.state.cols(); ++k) features.col(k) = box.Features(e.state.col(k));
    const MatrixXd target = scale.cwiseInverse().asDiagonal() * e.missing;
    parts.push_back({features * features.transpose(), features * target.transpose(), target.squaredNorm(),
                     static_cast<double>(e.state.cols())});
  }
  box.weights_ = BestWeights(parts) * scale.asDiagonal();
  return box;
}

VectorXd BlackBox::Features(const VectorXd& state) const {
  const VectorXd z = (state - mean_).cwiseQuotient(spread_).cwiseMin(high_).cwiseMax(low_);
  VectorXd out(1 + z.size() + project_.rows());
  out << 1.0, z, (project_ * z + phase_).array().tanh().matrix();
  return out;
}

VectorXd BlackBox::Residual(const VectorXd& q, const VectorXd& v, const VectorXd& u) const {
  VectorXd state(3 * q.size());
  state << q, v, u;
  return weights_.transpose() * Features(state);
}

MatrixXd BlackBox::Predict(const Recording& recording, double window_s) const {
  sim::Simulator simulator(nominal_);
  const sim::CommandSignal command = sysid::DriveSignal(recording);
  const int n = recording.n();
  MatrixXd out = recording.q;
  VectorXd u(n), q(n), v(n);
  for (const recordings::Window& w : recordings::SplitIntoWindows(recording.t, window_s)) {
    const VectorXd start = recording.has_velocity() ? VectorXd(recording.v.col(w.first))
                                                    : recordings::EstimateStateCausal(recording, w.first).v;
    sim::State x = simulator.MakeState(recording.q.col(w.first), start, recording.t[w.first]);
    bool ok = true;
    for (int row = w.first + 1; row <= w.last; ++row) {
      const double begin = recording.t[row - 1], span = recording.t[row] - begin;
      const int pieces = std::max(1, static_cast<int>(std::ceil(span / kPiece - 1e-9)));
      for (int k = 0; ok && k < pieces; ++k) {
        const double from = begin + span * k / pieces, to = begin + span * (k + 1) / pieces;
        for (int j = 0; j < n; ++j) u[j] = command.Average(j, from, to);
        u += Residual(x.q, x.v, u);
        ok = simulator.Advance(x, u, to - from).ok();
      }
      simulator.Measure(x, &q, &v);
      out.col(row) = q;
    }
  }
  return out;
}

}  // namespace rg::proof
