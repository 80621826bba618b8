#include "services/sysid/boxed_newton_step.h"

#include <Eigen/Cholesky>
#include <vector>

namespace rg::sysid {

using Eigen::MatrixXd;
using Eigen::VectorXd;

namespace {

constexpr int kMostIterations = 100;
constexpr int kMostHalvings = 30;
constexpr double kSettled = 1e-12;  // relative fall of the model below which nothing more is to be had

// Newton's direction of those that are free, zero for the others.
VectorXd DirectionOf(const MatrixXd& H, const VectorXd& gradient, const std::vector<int>& free) {
  const int f = static_cast<int>(free.size());
  MatrixXd H_ff(f, f);
  VectorXd b(f);
  for (int a = 0; a < f; ++a) {
    b[a] = -gradient[free[a]];
    for (int c = 0; c < f; ++c) H_ff(a, c) = H(free[a], free[c]);
  }
  const VectorXd x = H_ff.ldlt().solve(b);
  VectorXd direction = VectorXd::Zero(gradient.size());
  for (int a = 0; a < f; ++a) direction[free[a]] = x[a];
  return direction;
}

}  // namespace

VectorXd BoxedNewtonStep(const MatrixXd& H, const VectorXd& g, const VectorXd& low, const VectorXd& high) {
  const int P = static_cast<int>(g.size());
  VectorXd step = VectorXd::Zero(P).cwiseMax(low).cwiseMin(high);
  const auto model = [&](const VectorXd& x) { return g.dot(x) + 0.5 * x.dot(H * x); };
  double least = model(step);
  for (int it = 0; it < kMostIterations; ++it) {
    const VectorXd gradient = g + H * step;
    std::vector<int> free;
    for (int i = 0; i < P; ++i) {
      const bool held = (step[i] <= low[i] && gradient[i] > 0) || (step[i] >= high[i] && gradient[i] < 0);
      if (!held && low[i] < high[i]) free.push_back(i);
    }
    if (free.empty()) break;
    const VectorXd direction = DirectionOf(H, gradient, free);
    double length = 1.0, value = least;
    VectorXd next = step;
    for (int half = 0; half < kMostHalvings; ++half, length *= 0.5) {
      next = (step + length * direction).cwiseMax(low).cwiseMin(high);
      value = model(next);
      if (value <= least + 1e-4 * gradient.dot(next - step)) break;
    }
    if (!(value < least)) break;
    const bool settled = least - value <= kSettled * std::abs(value);
    step = std::move(next), least = value;
    if (settled) break;
  }
  return step;
}

}  // namespace rg::sysid
