#include "services/trajectories/tracking_cost.h"

#include <cmath>
#include <utility>

#include "common/base/check.h"

namespace rg::trajectories {

TrackingWeights TrackingWeights::Uniform(int n, double position, double velocity, double acceleration,
                                         double effort, double terminal_position, double terminal_velocity) {
  auto all = [n](double value) { return Eigen::VectorXd::Constant(n, value).eval(); };
  return {all(position), all(velocity),          all(acceleration),
          all(effort),   all(terminal_position), all(terminal_velocity)};
}

TrackingWeights TrackingWeights::ForBandwidth(double omega, const Eigen::VectorXd& torque_limit) {
  const int n = static_cast<int>(torque_limit.size());
  const double w2 = omega * omega;
  TrackingWeights w = Uniform(n, 1.0, 2.0 / w2, 1.0 / (w2 * w2), 0.0, 2.0 / omega, 2.0 / (w2 * omega));
  w.effort = 1e-4 * torque_limit.cwiseAbs2().cwiseMax(1e-6).cwiseInverse();
  return w;
}

TrackingCost::TrackingCost(int n, int nx, double interval_s, TrackingWeights weights)
    : n_(n), nx_(nx), h_(interval_s), w_(std::move(weights)) {
  RG_CHECK(n > 0 && nx >= 2 * n && interval_s > 0.0) << n << " joints, " << nx << " states";
  for (const Eigen::VectorXd* w : {&w_.position, &w_.velocity, &w_.acceleration, &w_.effort,
                                   &w_.terminal_position, &w_.terminal_velocity})
    RG_CHECK(w->size() == n && w->minCoeff() >= 0.0) << "weights: one ≥ 0 per joint";
  goal_ = effort_ = a_ = Eigen::VectorXd::Zero(n);
  a_dx_ = Eigen::MatrixXd::Zero(n, nx);
  a_du_ = Eigen::MatrixXd::Zero(n, n);
}

double TrackingCost::Stage(const VecIn& x, const VecIn& u, const VecIn& x_next) const {
  double sum = 0.0;
  for (int i = 0; i < n_; ++i) {
    const double e = x[i] - goal_[i];
    const double v = x[n_ + i];
    const double a = (x_next[n_ + i] - v) / h_;
    const double t = u[i] - effort_[i];
    sum +=
        w_.position[i] * e * e + w_.velocity[i] * v * v + w_.acceleration[i] * a * a + w_.effort[i] * t * t;
  }
  return 0.5 * h_ * sum;
}

void TrackingCost::StageQuadratic(const VecIn& x, const VecIn& u, const VecIn& x_next, const MatIn& A,
                                  const MatIn& B, QuadraticCost* out) {
  // Rows scaled by √(h W_a), so that the Gauss-Newton term is a plain JᵀJ.
  for (int i = 0; i < n_; ++i) {
    const double scale = std::sqrt(h_ * w_.acceleration[i]) / h_;
    a_[i] = scale * (x_next[n_ + i] - x[n_ + i]);
    a_dx_.row(i) = scale * A.row(n_ + i);
    a_dx_(i, n_ + i) -= scale;
    a_du_.row(i) = scale * B.row(n_ + i);
  }
  out->Q.noalias() = a_dx_.transpose() * a_dx_;
  out->S.noalias() = a_du_.transpose() * a_dx_;
  out->R.noalias() = a_du_.transpose() * a_du_;
  out->q.noalias() = a_dx_.transpose() * a_;
  out->r.noalias() = a_du_.transpose() * a_;
  for (int i = 0; i < n_; ++i) {
    out->Q(i, i) += h_ * w_.position[i];
    out->q[i] += h_ * w_.position[i] * (x[i] - goal_[i]);
    out->Q(n_ + i, n_ + i) += h_ * w_.velocity[i];
    out->q[n_ + i] += h_ * w_.velocity[i] * x[n_ + i];
    out->R(i, i) += h_ * w_.effort[i];
    out->r[i] += h_ * w_.effort[i] * (u[i] - effort_[i]);
  }
}

double TrackingCost::Terminal(const VecIn& x) const {
  double sum = 0.0;
  for (int i = 0; i < n_; ++i) {
    const double e = x[i] - goal_[i];
    sum += w_.terminal_position[i] * e * e + w_.terminal_velocity[i] * x[n_ + i] * x[n_ + i];
  }
  return 0.5 * sum;
}

void TrackingCost::TerminalQuadratic(const VecIn& x, MatOut Q, VecOut q) const {
  Q.setZero();
  q.setZero();
  for (int i = 0; i < n_; ++i) {
    Q(i, i) = w_.terminal_position[i];
    q[i] = w_.terminal_position[i] * (x[i] - goal_[i]);
    Q(n_ + i, n_ + i) = w_.terminal_velocity[i];
    q[n_ + i] = w_.terminal_velocity[i] * x[n_ + i];
  }
}

}  // namespace rg::trajectories
