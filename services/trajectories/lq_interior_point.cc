// The interior point of LqSolver: what finds the active sets when they cycle.
//
// Controls: slack·multiplier = μ on both sides of the box, Newton steps by a Riccati sweep with
// z/s added to the diagonal of R (Rao, Wright, Rawlings, JOTA 99(3), 1998). States: the one-sided penalty
// ρ·max(0, y) is replaced by (ρy + √(ρ²y² + 4ρμ))/2, its central path. μ falls to zero geometrically.
#include <algorithm>
#include <cmath>
#include <limits>

#include "services/trajectories/lq_solver.h"

namespace rg::trajectories {
namespace {

constexpr double kCentering = 0.15;        // μ aimed at, as a share of the present one
constexpr double kFractionToBound = 0.99;  // a step keeps this much of the way to the nearest bound
constexpr double kGapTolerance = 1e-11;    // relative to the first μ

// Smoothed ρ·max(0, y), its slope in `curvature`.
double SmoothPenalty(double rho, double y, double mu, double* curvature) {
  const double root = std::sqrt(rho * rho * y * y + 4.0 * rho * mu);
  *curvature = root > 0.0 ? 0.5 * rho * (1.0 + rho * y / root) : 0.0;
  // For y < 0 the sum cancels; this form does not.
  return y > 0.0 ? 0.5 * (rho * y + root) : (root > 0.0 ? 2.0 * rho * mu / (root - rho * y) : 0.0);
}

}  // namespace

// In the middle of the boxes, multipliers of the size of the gradient.
void LqSolver::StartInteriorPoint() {
  double scale = 1e-8;
  for (double g : u_grad_) scale = std::max(scale, std::abs(g));
  for (size_t i = 0; i < ip_u_.size(); ++i) {
    const double low = problem_.u_low[i], high = problem_.u_high[i];
    const bool has_low = std::isfinite(low), has_high = std::isfinite(high);
    ip_u_[i] = has_low && has_high ? 0.5 * (low + high)
               : has_low           ? std::max(0.0, low + 1.0)
               : has_high          ? std::min(0.0, high - 1.0)
                                   : 0.0;
    ip_low_[i] = has_low ? scale : 0.0;
    ip_high_[i] = has_high ? scale : 0.0;
  }
  du_ = ip_u_;
  Rollout();
  ip_x_ = dx_;
}

void LqSolver::TermsFromInteriorPoint(double regularization, double mu) {
  for (size_t i = 0; i < ip_u_.size(); ++i) {
    u_diagonal_[i] = regularization * problem_.regularization_scale[i % problem_.nu()];
    u_shift_[i] = 0.0;
    if (ip_low_[i] > 0.0) {
      const double slack = ip_u_[i] - problem_.u_low[i];
      u_diagonal_[i] += ip_low_[i] / slack;
      u_shift_[i] -= ip_low_[i] / slack * ip_u_[i] + mu / slack;
    }
    if (ip_high_[i] > 0.0) {
      const double slack = problem_.u_high[i] - ip_u_[i];
      u_diagonal_[i] += ip_high_[i] / slack;
      u_shift_[i] -= ip_high_[i] / slack * ip_u_[i] - mu / slack;
    }
  }
  const int nx = problem_.nx();
  for (size_t i = nx; i < ip_x_.size(); ++i) {
    x_diagonal_[i] = x_shift_[i] = 0.0;
    const double rho = problem_.rho[i % nx];
    if (rho == 0.0) continue;
    double above = 0.0, below = 0.0, above_curvature = 0.0, below_curvature = 0.0;
    if (std::isfinite(problem_.x_high[i]))
      above = SmoothPenalty(rho, ip_x_[i] - problem_.x_high[i], mu, &above_curvature);
    if (std::isfinite(problem_.x_low[i]))
      below = SmoothPenalty(rho, problem_.x_low[i] - ip_x_[i], mu, &below_curvature);
    x_diagonal_[i] = above_curvature + below_curvature;
    x_shift_[i] = above - below - x_diagonal_[i] * ip_x_[i];
  }
}

// The longest step ≤ 1 that keeps slacks and multipliers positive.
double LqSolver::InteriorStepLength(double mu) const {
  double length = 1.0;
  auto limit = [&length](double value, double change) {
    if (change < 0.0) length = std::min(length, -kFractionToBound * value / change);
  };
  for (size_t i = 0; i < ip_u_.size(); ++i) {
    const double step = du_[i] - ip_u_[i];
    if (ip_low_[i] > 0.0) {
      const double slack = ip_u_[i] - problem_.u_low[i];
      limit(slack, step);
      limit(ip_low_[i], (mu - ip_low_[i] * step) / slack - ip_low_[i]);
    }
    if (ip_high_[i] > 0.0) {
      const double slack = problem_.u_high[i] - ip_u_[i];
      limit(slack, -step);
      limit(ip_high_[i], (mu + ip_high_[i] * step) / slack - ip_high_[i]);
    }
  }
  return length;
}

void LqSolver::TakeInteriorStep(double length, double mu) {
  for (size_t i = 0; i < ip_u_.size(); ++i) {
    const double step = du_[i] - ip_u_[i];
    if (ip_low_[i] > 0.0) {
      const double slack = ip_u_[i] - problem_.u_low[i];
      ip_low_[i] += length * ((mu - ip_low_[i] * step) / slack - ip_low_[i]);
    }
    if (ip_high_[i] > 0.0) {
      const double slack = problem_.u_high[i] - ip_u_[i];
      ip_high_[i] += length * ((mu + ip_high_[i] * step) / slack - ip_high_[i]);
    }
    ip_u_[i] += length * step;
  }
  for (size_t i = 0; i < ip_x_.size(); ++i) ip_x_[i] += length * (dx_[i] - ip_x_[i]);
}

// Mean slack × multiplier.
double LqSolver::Complementarity() const {
  double sum = 0.0;
  int count = 0;
  for (size_t i = 0; i < ip_u_.size(); ++i) {
    if (ip_low_[i] > 0.0) sum += ip_low_[i] * (ip_u_[i] - problem_.u_low[i]), ++count;
    if (ip_high_[i] > 0.0) sum += ip_high_[i] * (problem_.u_high[i] - ip_u_[i]), ++count;
  }
  return count > 0 ? sum / count : 0.0;
}

void LqSolver::SetsFromInteriorPoint() {
  for (size_t i = 0; i < ip_u_.size(); ++i) {
    u_set_[i] = 0;
    if (ip_low_[i] > ip_u_[i] - problem_.u_low[i]) u_set_[i] = -1;
    if (ip_high_[i] > problem_.u_high[i] - ip_u_[i]) u_set_[i] = 1;
  }
  const int nx = problem_.nx();
  for (size_t i = nx; i < ip_x_.size(); ++i) {
    if (problem_.rho[i % nx] == 0.0) continue;
    x_set_[i] = ip_x_[i] > problem_.x_high[i] ? 1 : ip_x_[i] < problem_.x_low[i] ? -1 : 0;
  }
}

bool LqSolver::InteriorPoint(const LqOptions& options, LqSummary* summary) {
  StartInteriorPoint();
  std::fill(u_set_.begin(), u_set_.end(), int8_t{0});
  const double first = std::max(Complementarity(), 1e-8);
  double mu = kCentering * first;
  double residual = 1.0;  // share of the first residual of the equations that is left
  for (int sweep = 0; sweep < options.max_interior_sweeps; ++sweep) {
    TermsFromInteriorPoint(options.regularization, mu);
    if (!Sweep(problem_.knots(), summary)) return false;
    const double length = InteriorStepLength(mu);
    TakeInteriorStep(length, mu);
    residual *= 1.0 - length;
    const double gap = std::max(Complementarity(), length < 1.0 ? 0.0 : std::numeric_limits<double>::min());
    if (std::max(gap, mu) <= kGapTolerance * first && residual <= 1e-10) {
      summary->interior_converged = true;
      break;
    }
    // Without boxes on the controls only the smoothing of the penalties is left to reduce.
    mu = kCentering * (gap > std::numeric_limits<double>::min() ? gap : mu);
  }
  SetsFromInteriorPoint();
  return true;
}

}  // namespace rg::trajectories
