#include "services/diagnosis/likelihood/regressors.h"

#include <algorithm>
#include <cmath>

#include "common/base/check.h"

namespace rg::diagnosis {
namespace {

using Eigen::ArrayXd;

ArrayXd Bristle(const ArrayXd& q, double travel) {
  ArrayXd f(q.size());
  double x = 0;
  for (int k = 0; k < f.size(); ++k) {
    if (k > 0) {
      const double d = q[k] - q[k - 1];
      x = (x + d) / (1.0 + std::abs(d) / travel);
      x = std::clamp(x, -travel, travel);
    }
    f[k] = -x / travel;
  }
  return f;
}

ArrayXd Delayed(const ArrayXd& u, double dt, double seconds) {
  ArrayXd f(u.size());
  for (int k = 0; k < f.size(); ++k) {
    const double at = std::max(0.0, k - seconds / dt);
    const int a = static_cast<int>(at);
    const double w = at - a;
    f[k] = (1 - w) * u[a] + w * u[std::min<int>(a + 1, static_cast<int>(f.size()) - 1)] - u[k];
  }
  return f;
}

ArrayXd Lagging(const ArrayXd& u, double dt, double seconds) {
  ArrayXd f(u.size());
  const double decay = std::exp(-dt / seconds);
  double x = u[0];
  for (int k = 0; k < f.size(); ++k) {
    x = u[k] + (x - u[k]) * decay;
    f[k] = x - u[k];
  }
  return f;
}

// The torque of a spring, per unit of the inertia of its motor, which resonates at `omega` where its other
// end is held: θ̈ = drive − T,  T = ω²(θ − q) + 2ζω(θ̇ − v).
ArrayXd OfSpring(const ArrayXd& drive, const ArrayXd& v, double dt, double omega) {
  constexpr double kDamping = 0.1;
  constexpr int kSteps = 4;
  const double h = dt / kSteps, stiffness = omega * omega, damping = 2 * kDamping * omega;
  const Eigen::Index rows = v.size();
  ArrayXd f(rows);
  double x = drive[0] / stiffness, w = 0;  // θ − q, θ̇ − v
  for (Eigen::Index k = 0; k < rows; ++k) {
    const Eigen::Index before = std::max<Eigen::Index>(0, k - 1), after = std::min(rows - 1, k + 1);
    const double slope =
        (v[after] - v[before]) / (dt * static_cast<double>(std::max<Eigen::Index>(1, after - before)));
    double mean = 0;
    for (int i = 0; i < kSteps; ++i) {
      // Trapezoidal: stable, whatever the resonance.
      const double T = stiffness * (x + 0.5 * h * w) + damping * w;
      const double rate = (drive[k] - slope - T) / (1 + 0.5 * h * damping + 0.25 * h * h * stiffness);
      mean += stiffness * (x + 0.5 * h * (w + 0.5 * h * rate)) + damping * (w + 0.5 * h * rate);
      x += h * (w + 0.5 * h * rate), w += h * rate;
    }
    f[k] = mean / kSteps;
  }
  return f;
}

// A cubic B-spline.
ArrayXd Piece(const ArrayXd& q, const RegressorShape& s) {
  const ArrayXd x = ((q - s.x) / s.y).abs();
  return ((2.0 - x).max(0.0).cube() - 4.0 * (1.0 - x).max(0.0).cube()) / 6.0;
}

ArrayXd Pulse(const ArrayXd& t, const RegressorShape& s) {
  const ArrayXd since = t - t[0];
  return (since >= s.x && since < s.y).cast<double>();
}

}  // namespace

JointMotion MotionOf(const FineMotion& m, const MatrixXd& effort, int j) {
  const auto row = [j](const MatrixXd& x) -> ArrayXd { return x.row(j).transpose().array(); };
  const ArrayXd t = Eigen::Map<const ArrayXd>(m.t.data(), static_cast<Eigen::Index>(m.t.size()));
  const ArrayXd v = row(m.v);
  return {row(m.q), v, row(m.a), t, row(effort), v.sign()};
}

ArrayXd ForceOf(effects::Regressor regressor, const JointMotion& m, const RegressorShape& s) {
  using enum effects::Regressor;
  switch (regressor) {
    case kVelocity:
      return -m.v;
    case kSquaredVelocity:
      return -m.v * m.v.abs();
    case kDirection:
      return -m.direction;
    case kForwards:
      return -m.direction.max(0.0);
    case kBackwards:
      return -m.direction.min(0.0);
    case kSlowly:
      return -m.direction * (-(m.v / s.x).square()).exp();
    case kUnderLoad:
      return -m.direction * m.effort.abs();
    case kWarmingUp:
      return -m.direction * (-m.t / s.x).exp();
    case kBristle:
      return Bristle(m.q, s.x);
    case kEffort:
    case kOtherEffort:
      return m.effort;
    case kConstant:
      return ArrayXd::Ones(m.v.size());
    case kInBand:
      return -m.effort.max(-s.x).min(s.x);
    case kBeyond:
      return m.effort.max(-s.x).min(s.x) - m.effort;
    case kDelayed:
      return Delayed(m.effort, m.t[1] - m.t[0], s.x);
    case kLagging:
      return Lagging(m.effort, m.t[1] - m.t[0], s.x);
    case kThroughSpring:
      return OfSpring(m.effort, ArrayXd::Zero(m.v.size()), m.t[1] - m.t[0], s.x) - m.effort;
    case kSprungRotor:
      return OfSpring(ArrayXd::Zero(m.v.size()), m.v, m.t[1] - m.t[0], s.x);
    case kPosition:
      return -(m.q - s.x);
    case kSine:
      return (s.x * m.q).sin();
    case kCosine:
      return (s.x * m.q).cos();
    case kPositionPiece:
      return Piece(m.q, s);
    case kVelocityPiece:
      return Piece(m.v, s);
    case kAcceleration:
      return -m.a;
    case kPulse:
      return Pulse(m.t, s);
  }
  RG_CHECK(false);
  return {};
}

}  // namespace rg::diagnosis
