#include "services/proof/black_box.h"

#include <Eigen/Cholesky>
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

constexpr int kFeatures = 192;
constexpr double kBlock = 0.08;   // s over which torque and features are averaged
constexpr double kPiece = 0.005;  // s, in prediction
constexpr double kRidge[] = {1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0};

struct Examples {
  MatrixXd state, missing;  // 3n × m, n × m: of each interval between rows
  int block = 1;            // intervals that are averaged
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

// Between two rows the mean acceleration, state and command are exact to second order, whatever the rate.
Examples ExamplesOf(const sim::Plant& plant, const Recording& recording) {
  const int n = recording.n(), m = recording.rows() - 1;
  const dynamics::Mechanism mechanism = sysid::MechanismOf(plant, plant.parameters().Nominal());
  const MatrixXd declared = Declared(plant), speed = recordings::VelocityOrEstimate(recording);
  const sim::CommandSignal command = sysid::DriveSignal(recording);
  dynamics::Workspace workspace;
  Examples out{MatrixXd(3 * n, m), MatrixXd(n, m),
               std::max(1, static_cast<int>(std::lround(kBlock / recording.SamplePeriod())))};
  VectorXd u(n), torque(n);
  for (int k = 0; k < m; ++k) {
    const double span = recording.t[k + 1] - recording.t[k];
    const VectorXd q = 0.5 * (recording.q.col(k) + recording.q.col(k + 1)),
                   v = 0.5 * (speed.col(k) + speed.col(k + 1)), a = (speed.col(k + 1) - speed.col(k)) / span;
    for (int j = 0; j < n; ++j) u[j] = command.Average(j, recording.t[k], recording.t[k + 1]);
    dynamics::Rnea(mechanism, workspace, q, v, a, torque);
    torque += declared.col(0).cwiseProduct(v) + declared.col(1).cwiseProduct(v.cwiseSign());
    out.state.col(k) << q, v, u;
    out.missing.col(k) = torque - u;
  }
  return out;
}

// Means over blocks that overlap by half.
MatrixXd Blocks(const MatrixXd& x, int block) {
  const int step = std::max(1, block / 2);
  const Eigen::Index count = x.cols() < block ? 0 : (x.cols() - block) / step + 1;
  MatrixXd out(x.rows(), count);
  for (Eigen::Index b = 0; b < count; ++b) out.col(b) = x.middleCols(b * step, block).rowwise().mean();
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
    if (recording->rows() < 10) continue;
    Examples one = ExamplesOf(nominal, *recording);
    rows += one.state.cols();
    examples.push_back(std::move(one));
  }
  const int inputs = 3 * nominal.num_joints();
  if (rows < 10 * inputs || examples.size() < 2) return FailedPreconditionError("too little to learn from");
  MatrixXd states(inputs, rows);
  VectorXd square = VectorXd::Zero(nominal.num_joints());
  for (Eigen::Index at = 0; const Examples& e : examples) {
    states.middleCols(at, e.state.cols()) = e.state;
    square += Blocks(e.missing, e.block).rowwise().squaredNorm() * static_cast<double>(e.block);
    at += e.state.cols();
  }
  box.mean_ = states.rowwise().mean();
  box.spread_ = ((states.colwise() - box.mean_).rowwise().squaredNorm() / rows).cwiseSqrt().cwiseMax(1e-9);
  box.low_ = (states.rowwise().minCoeff() - box.mean_).cwiseQuotient(box.spread_);
  box.high_ = (states.rowwise().maxCoeff() - box.mean_).cwiseQuotient(box.spread_);
  // The torques of light and heavy joints count alike.
  const VectorXd scale = (square / rows).cwiseSqrt().cwiseMax(1e-12);
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
    const MatrixXd mean = Blocks(features, e.block),
                   target = scale.cwiseInverse().asDiagonal() * Blocks(e.missing, e.block);
    parts.push_back({mean * mean.transpose(), mean * target.transpose(), target.squaredNorm(),
                     static_cast<double>(mean.cols())});
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
  for (const recordings::Window& w : recordings::SplitIntoWindows(recording, window_s)) {
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
