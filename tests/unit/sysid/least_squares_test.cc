#include "services/sysid/least_squares.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>

#include <limits>
#include <utility>
#include <vector>

#include "tests/unit/sysid/toy_residuals.h"

namespace rg::sysid {
namespace {

using Eigen::MatrixXd;
using Eigen::Vector2d;
using Eigen::VectorXd;

SolveOptions With(Solver solver) {
  SolveOptions options;
  options.solver = solver;
  options.max_iterations = 500;
  return options;
}

class BothSolvers : public ::testing::TestWithParam<Solver> {};
INSTANTIATE_TEST_SUITE_P(Solvers, BothSolvers,
                         ::testing::Values(Solver::kBoundedLevenbergMarquardt, Solver::kUnboundedLbfgs));

TEST_P(BothSolvers, FindTheMinimumOfRosenbrocksValley) {
  auto residuals = testing::Rosenbrock();
  const auto problem = testing::FreeProblem(&residuals, Vector2d(-1.2, 1.0));
  const SolveSummary s = Solve(problem, problem.initial, With(GetParam()), {});
  EXPECT_EQ(s.termination, Termination::kConverged) << s.message;
  EXPECT_NEAR(s.p[0], 1.0, 1e-4);
  EXPECT_NEAR(s.p[1], 1.0, 2e-4);
  EXPECT_GT(s.evaluations, 0);
}

TEST_P(BothSolvers, AgreeWithTheClosedFormOfARegularisedConvexProblem) {
  const MatrixXd A = MatrixXd::Random(30, 6);
  const VectorXd b = VectorXd::Random(30);
  auto residuals = testing::Linear(A, b);
  auto problem = testing::FreeProblem(&residuals, VectorXd::Random(6));
  problem.alpha = VectorXd::LinSpaced(6, 0.0, 5.0);
  const MatrixXd H = A.transpose() * A + MatrixXd(problem.alpha.asDiagonal());
  const VectorXd expected = H.ldlt().solve(A.transpose() * b + problem.alpha.cwiseProduct(problem.initial));
  const SolveSummary s = Solve(problem, VectorXd::Random(6), With(GetParam()), {});
  EXPECT_LT((s.p - expected).norm(), 1e-4 * expected.norm());
  const double regulariser = (problem.alpha.array() * (s.p - problem.initial).array().square()).sum();
  EXPECT_NEAR(s.cost, (A * s.p - b).squaredNorm() + regulariser, 1e-9);
  EXPECT_NEAR(s.residual, (A * s.p - b).squaredNorm(), 1e-9);
}

TEST_P(BothSolvers, LeaveParametersWithoutEffectWhereTheyAre) {
  MatrixXd A = MatrixXd::Random(20, 5);
  A.col(2).setZero();
  auto residuals = testing::Linear(A, VectorXd::Random(20));
  const auto problem = testing::FreeProblem(&residuals, VectorXd::Constant(5, 0.7));
  const SolveSummary s = Solve(problem, problem.initial, With(GetParam()), {});
  EXPECT_EQ(s.termination, Termination::kConverged) << s.message;
  EXPECT_DOUBLE_EQ(s.p[2], 0.7);
}

TEST_P(BothSolvers, KeepAParameterWhoseBoundsCoincide) {
  auto residuals = testing::Linear(MatrixXd::Random(20, 3), VectorXd::Random(20));
  auto problem = testing::FreeProblem(&residuals, VectorXd::Zero(3));
  problem.lower[1] = problem.upper[1] = 0.0;  // ±20 % of a link without inertia
  const SolveSummary s = Solve(problem, problem.initial, With(GetParam()), {});
  EXPECT_EQ(s.p[1], 0.0);
  EXPECT_NE(s.p[0], 0.0);
}

TEST_P(BothSolvers, SolveBadlyScaledProblemsThroughTheScale) {
  // A gravity of 9.81 beside an inertia of 8e-4.
  MatrixXd A = MatrixXd::Random(40, 2);
  A.col(1) *= 1e4;
  const Vector2d truth(9.5, 7e-4);
  auto residuals = testing::Linear(A, A * truth);
  auto problem = testing::FreeProblem(&residuals, Vector2d(9.81, 8e-4));
  problem.scale = Vector2d(1.0, 1e-4);
  const SolveSummary s = Solve(problem, problem.initial, With(GetParam()), {});
  EXPECT_NEAR(s.p[0], truth[0], 1e-4);
  EXPECT_NEAR(s.p[1], truth[1], 1e-8);
}

TEST(BoundedLevenbergMarquardt, HoldsItsBoundsAndUsesThem) {
  auto residuals = testing::Linear(MatrixXd::Identity(2, 2), Vector2d(3.0, 0.5));
  auto problem = testing::FreeProblem(&residuals, Vector2d(0.0, 0.0));
  problem.lower = Vector2d(-1.0, -1.0);
  problem.upper = Vector2d(1.0, 1.0);
  const SolveSummary s = Solve(problem, Vector2d(-5.0, 0.0), With(Solver::kBoundedLevenbergMarquardt), {});
  EXPECT_DOUBLE_EQ(s.p[0], 1.0);
  EXPECT_NEAR(s.p[1], 0.5, 1e-6);
}

// The search along the projected step, the verdict on it and the next Jacobian are asked for at one point.
TEST(BoundedLevenbergMarquardt, EvaluatesNoPointTwice) {
  auto valley = testing::Rosenbrock();
  std::vector<std::pair<VectorXd, bool>> asked;
  testing::LambdaResiduals counted(
      2, 2, [&](const VectorXd& p, const StopCondition& stop, VectorXd* r, RowMatrix* J) {
        asked.emplace_back(p, J != nullptr);
        return valley.Evaluate(p, stop, r, J);
      });
  auto problem = testing::FreeProblem(&counted, Vector2d(-1.2, 1.0));
  problem.lower = Vector2d(-3.0, -3.0);
  problem.upper = Vector2d(3.0, 3.0);
  const SolveSummary s = Solve(problem, problem.initial, With(Solver::kBoundedLevenbergMarquardt), {});
  EXPECT_LT(s.cost, 1e-8);
  EXPECT_EQ(s.evaluations, static_cast<int>(asked.size()));
  for (size_t k = 1; k < asked.size(); ++k) {
    EXPECT_FALSE(asked[k].first == asked[k - 1].first && asked[k - 1].second) << "evaluation " << k;
  }
}

TEST(UnboundedLbfgs, PassesTheBoundsOfTheOtherSolver) {
  auto residuals = testing::Linear(MatrixXd::Identity(2, 2), Vector2d(3.0, 0.5));
  auto problem = testing::FreeProblem(&residuals, Vector2d(0.0, 0.0));
  problem.lower = Vector2d(-1.0, -1.0);
  problem.upper = Vector2d(1.0, 1.0);
  const SolveSummary s = Solve(problem, problem.initial, With(Solver::kUnboundedLbfgs), {});
  EXPECT_NEAR(s.p[0], 3.0, 1e-5);
}

// Each evaluation costs 0.1 s of a clock moved by hand.
TEST_P(BothSolvers, StopWithinOneEvaluationOfTheBudgetAndKeepTheBest) {
  FakeClock clock;
  auto valley = testing::Rosenbrock();
  testing::LambdaResiduals slow(2, 2,
                                [&](const VectorXd& p, const StopCondition& stop, VectorXd* r, RowMatrix* J) {
                                  clock.Advance(100'000'000);
                                  return valley.Evaluate(p, stop, r, J);
                                });
  const auto problem = testing::FreeProblem(&slow, Vector2d(-1.2, 1.0));
  const double start = clock.SteadySeconds();
  const SolveSummary s = Solve(problem, problem.initial, With(GetParam()), StopCondition(clock, 1.0));
  EXPECT_EQ(s.termination, Termination::kStopped);
  EXPECT_LE(clock.SteadySeconds() - start, 1.1 + 1e-9);
  double cost = 0.0, initial_cost = 0.0;
  ASSERT_TRUE(EvaluateCost(problem, s.p, {}, &cost));
  ASSERT_TRUE(EvaluateCost(problem, problem.initial, {}, &initial_cost));
  EXPECT_DOUBLE_EQ(cost, s.cost);
  EXPECT_LT(cost, initial_cost);
}

TEST_P(BothSolvers, StopOnCancel) {
  CancelToken cancel;
  auto valley = testing::Rosenbrock();
  int evaluations = 0;
  testing::LambdaResiduals cancels(
      2, 2, [&](const VectorXd& p, const StopCondition& stop, VectorXd* r, RowMatrix* J) {
        if (++evaluations == 4) cancel.Cancel();
        return valley.Evaluate(p, stop, r, J);
      });
  const auto problem = testing::FreeProblem(&cancels, Vector2d(-1.2, 1.0));
  const SolveSummary s = Solve(problem, problem.initial, With(GetParam()), StopCondition(&cancel));
  EXPECT_EQ(s.termination, Termination::kStopped);
  EXPECT_EQ(evaluations, 4);
}

TEST_P(BothSolvers, SurviveARegionThatIsNotFinite) {
  // sqrt(p) with the optimum at 0.01, started at 9: a full step lands below zero.
  testing::LambdaResiduals root(1, 1, [](const VectorXd& p, const StopCondition&, VectorXd* r, RowMatrix* J) {
    if (p[0] <= 0.0) return false;
    (*r)[0] = std::sqrt(p[0]) - 0.1;
    if (J != nullptr) (*J)(0, 0) = 0.5 / std::sqrt(p[0]);
    return true;
  });
  const auto problem = testing::FreeProblem(&root, VectorXd::Constant(1, 9.0));
  const SolveSummary s = Solve(problem, problem.initial, With(GetParam()), {});
  EXPECT_NEAR(s.p[0], 0.01, 1e-4) << s.message;
}

TEST_P(BothSolvers, SayThatAStartThatIsNotFiniteFailed) {
  testing::LambdaResiduals never(
      1, 1, [](const VectorXd&, const StopCondition&, VectorXd*, RowMatrix*) { return false; });
  const auto problem = testing::FreeProblem(&never, VectorXd::Constant(1, 1.0));
  const SolveSummary s = Solve(problem, problem.initial, With(GetParam()), {});
  EXPECT_EQ(s.termination, Termination::kFailed);
  EXPECT_FALSE(std::isfinite(s.cost));
}

}  // namespace
}  // namespace rg::sysid
