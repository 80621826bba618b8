#include "services/trajectories/tracking_cost.h"

#include <gtest/gtest.h>

#include "common/base/rng.h"

namespace rg::trajectories {
namespace {

// A linear step makes the quadratic model of the cost exact, value, gradient and Hessian.
TEST(TrackingCost, QuadraticModelIsExactForALinearStep) {
  const int n = 2, nx = 5, nu = 2;
  Rng rng(1);
  auto random = [&](int rows, int cols) {
    Eigen::MatrixXd m(rows, cols);
    for (int i = 0; i < m.size(); ++i) m(i) = rng.Normal();
    return m;
  };
  TrackingCost cost(n, nx, 0.04, TrackingWeights::Uniform(n, 3.0, 0.5, 0.02, 0.1, 7.0, 2.0));
  cost.set_goal(random(n, 1));
  cost.set_effort_reference(random(n, 1));
  const Eigen::MatrixXd A = random(nx, nx), B = random(nx, nu);
  const Eigen::VectorXd x = random(nx, 1), u = random(nu, 1);

  Eigen::MatrixXd Q(nx, nx), S(nu, nx), R(nu, nu);
  Eigen::VectorXd q(nx), r(nu);
  QuadraticCost quadratic{Q, S, R, q, r};
  cost.StageQuadratic(x, u, A * x + B * u, A, B, &quadratic);
  const double value = cost.Stage(x, u, A * x + B * u);
  for (int trial = 0; trial < 5; ++trial) {
    const Eigen::VectorXd dx = random(nx, 1), du = random(nu, 1);
    const double model =
        value + q.dot(dx) + r.dot(du) + 0.5 * dx.dot(Q * dx) + du.dot(S * dx) + 0.5 * du.dot(R * du);
    EXPECT_NEAR(model, cost.Stage(x + dx, u + du, A * (x + dx) + B * (u + du)), 1e-10);
  }
  cost.TerminalQuadratic(x, Q, q);
  const Eigen::VectorXd dx = random(nx, 1);
  EXPECT_NEAR(cost.Terminal(x) + q.dot(dx) + 0.5 * dx.dot(Q * dx), cost.Terminal(x + dx), 1e-10);
}

}  // namespace
}  // namespace rg::trajectories
