#include "services/trajectories/lq_solver.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <limits>

#include "common/base/rng.h"

namespace rg::trajectories {
namespace {

Eigen::MatrixXd RandomMatrix(Rng& rng, int rows, int cols, double scale) {
  Eigen::MatrixXd m(rows, cols);
  for (int j = 0; j < cols; ++j)
    for (int i = 0; i < rows; ++i) m(i, j) = scale * rng.Normal();
  return m;
}

void FillRandom(Rng& rng, LqProblem* lq) {
  const int nx = lq->nx(), nu = lq->nu();
  for (int k = 0; k <= lq->knots(); ++k) {
    const Eigen::MatrixXd half = RandomMatrix(rng, nx + nu, nx + nu, 0.6);
    const Eigen::MatrixXd hessian =
        half.transpose() * half + 0.1 * Eigen::MatrixXd::Identity(nx + nu, nx + nu);
    lq->Q(k) = hessian.topLeftCorner(nx, nx);
    lq->q(k) = RandomMatrix(rng, nx, 1, 1.0);
    if (k == lq->knots()) continue;
    lq->S(k) = hessian.bottomLeftCorner(nu, nx);
    lq->R(k) = hessian.bottomRightCorner(nu, nu);
    lq->r(k) = RandomMatrix(rng, nu, 1, 1.0);
    lq->A(k) = Eigen::MatrixXd::Identity(nx, nx) + RandomMatrix(rng, nx, nx, 0.15);
    lq->B(k) = RandomMatrix(rng, nx, nu, 0.4);
    lq->d(k) = RandomMatrix(rng, nx, 1, 0.1);
  }
  lq->dx0 = RandomMatrix(rng, nx, 1, 0.5);
}

// The problem with states eliminated: ½ uᵀHu + gᵀu, x = Fu + f.
struct Condensed {
  Eigen::MatrixXd H, F;
  Eigen::VectorXd g, f;
};

Condensed Condense(LqProblem& lq) {
  const int nx = lq.nx(), nu = lq.nu(), n = lq.knots();
  Condensed c;
  c.F = Eigen::MatrixXd::Zero((n + 1) * nx, n * nu);
  c.f = Eigen::VectorXd::Zero((n + 1) * nx);
  c.f.head(nx) = lq.dx0;
  for (int k = 0; k < n; ++k) {
    c.f.segment((k + 1) * nx, nx) = lq.A(k) * c.f.segment(k * nx, nx) + lq.d(k);
    c.F.middleRows((k + 1) * nx, nx) = lq.A(k) * c.F.middleRows(k * nx, nx);
    c.F.block((k + 1) * nx, k * nu, nx, nu) += lq.B(k);
  }
  c.H = Eigen::MatrixXd::Zero(n * nu, n * nu);
  c.g = Eigen::VectorXd::Zero(n * nu);
  for (int k = 0; k <= n; ++k) {
    const Eigen::MatrixXd Fk = c.F.middleRows(k * nx, nx);
    const Eigen::VectorXd fk = c.f.segment(k * nx, nx);
    c.H += Fk.transpose() * lq.Q(k) * Fk;
    c.g += Fk.transpose() * (lq.Q(k) * fk + lq.q(k));
    if (k == n) continue;
    Eigen::MatrixXd E = Eigen::MatrixXd::Zero(nu, n * nu);
    E.middleCols(k * nu, nu).setIdentity();
    c.H +=
        E.transpose() * lq.S(k) * Fk + Fk.transpose() * lq.S(k).transpose() * E + E.transpose() * lq.R(k) * E;
    c.g += E.transpose() * (lq.S(k) * fk + lq.r(k));
  }
  return c;
}

Eigen::VectorXd Controls(const LqSolver& solver, int nu, int knots) {
  Eigen::VectorXd u(nu * knots);
  for (int k = 0; k < knots; ++k) u.segment(k * nu, nu) = solver.du(k);
  return u;
}

class LqSizes : public ::testing::TestWithParam<std::pair<int, int>> {};

TEST_P(LqSizes, WithoutBoxesEqualsTheCondensedLinearSystem) {
  const auto [nx, nu] = GetParam();
  Rng rng(11);
  const int knots = 7;
  LqSolver solver(nx, nu, knots);
  FillRandom(rng, &solver.problem());
  const LqSummary summary = solver.Solve({});
  ASSERT_TRUE(summary.ok && summary.exact);
  EXPECT_EQ(summary.sweeps, 1);
  const Condensed c = Condense(solver.problem());
  const Eigen::VectorXd oracle = c.H.ldlt().solve(-c.g);
  const Eigen::VectorXd u = Controls(solver, nu, knots);
  EXPECT_LT((u - oracle).lpNorm<Eigen::Infinity>(), 1e-8 * (1.0 + oracle.lpNorm<Eigen::Infinity>()));
  const Eigen::VectorXd x = c.F * u + c.f;
  for (int k = 0; k <= knots; ++k) EXPECT_LT((solver.dx(k) - x.segment(k * nx, nx)).norm(), 1e-8);
}

TEST_P(LqSizes, BoxesOnControlsSatisfyTheOptimalityConditions) {
  const auto [nx, nu] = GetParam();
  Rng rng(5);
  const int knots = 9;
  int total_active = 0;
  for (int trial = 0; trial < 20; ++trial) {
    LqSolver solver(nx, nu, knots);
    FillRandom(rng, &solver.problem());
    for (int k = 0; k < knots; ++k) {
      solver.problem().u_lo(k).setConstant(-0.4);
      solver.problem().u_hi(k).setConstant(0.3);
    }
    const LqSummary summary = solver.Solve({});
    ASSERT_TRUE(summary.ok && summary.exact) << "trial " << trial << ", sweeps " << summary.sweeps;
    total_active += summary.active_controls;
    const Condensed c = Condense(solver.problem());
    const Eigen::VectorXd u = Controls(solver, nu, knots);
    const Eigen::VectorXd gradient = c.H * u + c.g;
    // KKT of a box: the projected gradient step does not move.
    for (int i = 0; i < u.size(); ++i) {
      EXPECT_GE(u[i], -0.4);
      EXPECT_LE(u[i], 0.3);
      EXPECT_NEAR(std::clamp(u[i] - gradient[i], -0.4, 0.3), u[i], 1e-7) << "trial " << trial << " u " << i;
    }
  }
  EXPECT_GT(total_active, 20 * nu);
}

TEST_P(LqSizes, PenaltyOnStatesIsMinimisedExactly) {
  const auto [nx, nu] = GetParam();
  Rng rng(8);
  const int knots = 6;
  LqSolver solver(nx, nu, knots);
  LqProblem& lq = solver.problem();
  FillRandom(rng, &lq);
  lq.rho.setConstant(50.0);
  for (int k = 1; k <= knots; ++k) {
    lq.x_lo(k).setConstant(-0.3);
    lq.x_hi(k).setConstant(0.2);
  }
  const LqSummary summary = solver.Solve({});
  ASSERT_TRUE(summary.ok && summary.exact);
  EXPECT_GT(summary.active_states, 0);
  const Condensed c = Condense(lq);
  const Eigen::VectorXd u = Controls(solver, nu, knots);
  const Eigen::VectorXd x = c.F * u + c.f;
  Eigen::VectorXd excess = Eigen::VectorXd::Zero(x.size());
  for (int i = nx; i < x.size(); ++i) excess[i] = x[i] - std::clamp(x[i], -0.3, 0.2);
  const Eigen::VectorXd gradient = c.H * u + c.g + 50.0 * c.F.transpose() * excess;
  EXPECT_LT(gradient.lpNorm<Eigen::Infinity>(), 1e-7);
}

INSTANTIATE_TEST_SUITE_P(FixedAndRunTimeSizes, LqSizes,
                         ::testing::Values(std::pair(2, 1), std::pair(4, 2), std::pair(12, 6),
                                           std::pair(14, 7), std::pair(5, 3), std::pair(18, 6)));

TEST(LqSolver, GainConvergesToTheAlgebraicRiccatiEquation) {
  const int knots = 400;
  LqSolver solver(2, 1, knots);
  LqProblem& lq = solver.problem();
  const double h = 0.04;
  for (int k = 0; k <= knots; ++k) {
    lq.Q(k) = Eigen::Vector2d(2.0, 0.3).asDiagonal();
    if (k == knots) break;
    lq.R(k)(0, 0) = 0.05;
    lq.A(k) << 1.0, h, 0.0, 1.0;
    lq.B(k) << 0.5 * h * h, h;
  }
  ASSERT_TRUE(solver.Solve({}).exact);
  // P = Q + AᵀPA − AᵀPB (R + BᵀPB)⁻¹ BᵀPA
  const Eigen::Matrix2d P = solver.cost_to_go(0);
  const Eigen::Matrix2d A = lq.A(0);
  const Eigen::Vector2d B = lq.B(0);
  const Eigen::RowVector2d K = -(B.transpose() * P * A) / (0.05 + B.dot(P * B));
  const Eigen::Matrix2d residual =
      Eigen::Matrix2d(lq.Q(0)) + A.transpose() * P * A + A.transpose() * P * B * K - P;
  EXPECT_LT(residual.norm(), 1e-9 * P.norm());
  EXPECT_LT((solver.gain(0) - K).norm(), 1e-9);
}

TEST(LqSolver, CostateIsTheGradientOfTheCostToGo) {
  Rng rng(2);
  LqSolver solver(4, 2, 5);
  LqProblem& lq = solver.problem();
  FillRandom(rng, &lq);
  auto cost = [&](const Eigen::VectorXd& dx0) {
    lq.dx0 = dx0;
    EXPECT_TRUE(solver.Solve({}).ok);
    double sum = 0.0;
    for (int k = 0; k <= 5; ++k) {
      const Eigen::VectorXd x = solver.dx(k);
      sum += 0.5 * x.dot(lq.Q(k) * x) + lq.q(k).dot(x);
      if (k == 5) continue;
      const Eigen::VectorXd u = solver.du(k);
      sum += 0.5 * u.dot(lq.R(k) * u) + u.dot(lq.S(k) * x) + lq.r(k).dot(u);
    }
    return sum;
  };
  const Eigen::VectorXd dx0 = lq.dx0;
  cost(dx0);
  const Eigen::VectorXd costate = solver.costate(0);
  for (int i = 0; i < 4; ++i) {
    Eigen::VectorXd step = Eigen::VectorXd::Unit(4, i) * 1e-5;
    EXPECT_NEAR((cost(dx0 + step) - cost(dx0 - step)) / 2e-5, costate[i], 1e-6);
  }
}

TEST(LqSolver, WarmActiveSetNeedsOneSweep) {
  Rng rng(3);
  LqSolver solver(12, 6, 25);
  FillRandom(rng, &solver.problem());
  for (int k = 0; k < 25; ++k) {
    solver.problem().u_lo(k).setConstant(-0.2);
    solver.problem().u_hi(k).setConstant(0.2);
  }
  const LqSummary cold = solver.Solve({});
  ASSERT_TRUE(cold.exact);
  EXPECT_GT(cold.sweeps, 1);
  EXPECT_EQ(solver.Solve({}).sweeps, 1);
}

TEST(LqSolver, IndefiniteHessianIsReportedWithItsKnotAndCuredByRegularization) {
  Rng rng(4);
  LqSolver solver(2, 1, 6);
  FillRandom(rng, &solver.problem());
  solver.problem().R(3)(0, 0) = -100.0;
  const LqSummary summary = solver.Solve({});
  EXPECT_FALSE(summary.ok);
  EXPECT_EQ(summary.knot, 3);
  LqOptions options;
  options.regularization = 200.0;
  EXPECT_TRUE(solver.Solve(options).ok);
}

TEST(LqSolver, RegularizationShortensTheStep) {
  Rng rng(6);
  LqSolver solver(4, 2, 6);
  FillRandom(rng, &solver.problem());
  ASSERT_TRUE(solver.Solve({}).ok);
  const double free = Controls(solver, 2, 6).norm();
  LqOptions options;
  options.regularization = 1e3;
  ASSERT_TRUE(solver.Solve(options).ok);
  EXPECT_LT(Controls(solver, 2, 6).norm(), 0.1 * free);
}

}  // namespace
}  // namespace rg::trajectories
