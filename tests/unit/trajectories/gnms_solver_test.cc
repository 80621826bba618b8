#include "services/trajectories/gnms_solver.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <numbers>

#include "common/base/clock.h"
#include "tests/unit/trajectories/test_problems.h"

namespace rg::trajectories {
namespace {

constexpr double kPi = std::numbers::pi;

TEST(Gnms, LinearQuadraticProblemIsSolvedInOneStep) {
  DoubleIntegrators problem(2, 25, 0.04, TrackingWeights::Uniform(2, 10.0, 0.1, 0.0, 0.02, 50.0, 5.0));
  problem.cost().set_goal(Eigen::Vector2d(0.5, -0.3));
  GnmsSolver solver(problem, {});
  const GnmsSummary summary = solver.Solve(Eigen::VectorXd::Zero(4));
  EXPECT_TRUE(summary.converged()) << summary.message;
  EXPECT_EQ(summary.iterations, 2);  // the second sees that nothing moves
  EXPECT_LT(summary.max_defect, 1e-12);
}

TEST(Gnms, TorqueBoxHoldsExactlyAndIsBangBangForAFastMove) {
  DoubleIntegrators problem(1, 25, 0.04, TrackingWeights::Uniform(1, 100.0, 0.0, 0.0, 1e-6, 1e4, 1e3));
  problem.cost().set_goal(Eigen::VectorXd::Constant(1, 1.0));
  problem.u_lower_.setConstant(-4.5);
  problem.u_upper_.setConstant(4.5);
  GnmsSolver solver(problem, {});
  const GnmsSummary summary = solver.Solve(Eigen::VectorXd::Zero(2));
  EXPECT_TRUE(summary.converged()) << summary.message;
  int at_bound = 0;
  for (int k = 0; k < 25; ++k) {
    EXPECT_LE(std::abs(solver.u(k)[0]), 4.5);
    at_bound += std::abs(solver.u(k)[0]) == 4.5;
  }
  EXPECT_GE(at_bound, 15);
  EXPECT_NEAR(solver.x(25)[0], 1.0, 1e-3);
}

TEST(Gnms, VelocityBoxIsHeldToTolerance) {
  DoubleIntegrators problem(1, 50, 0.04, TrackingWeights::Uniform(1, 10.0, 0.0, 0.0, 1e-3, 100.0, 10.0));
  problem.cost().set_goal(Eigen::VectorXd::Constant(1, 0.75));
  problem.x_lower_[1] = -0.6;
  problem.x_upper_[1] = 0.6;
  GnmsSolver solver(problem, {});
  const GnmsSummary summary = solver.Solve(Eigen::VectorXd::Zero(2));
  EXPECT_TRUE(summary.converged()) << summary.message << " " << summary.iterations;
  int at_bound = 0;
  for (int k = 1; k <= 50; ++k) {
    EXPECT_LE(solver.x(k)[1], 0.6 + 1e-4);
    at_bound += solver.x(k)[1] > 0.6 - 1e-3;
  }
  EXPECT_GE(at_bound, 5);
}

TEST(Gnms, PendulumSwingsUpWithATorqueThatCannotHoldIt) {
  Pendulum problem(80, 0.05, TrackingWeights::Uniform(1, 0.1, 0.01, 0.0, 1e-2, 300.0, 30.0));
  problem.cost().set_goal(Eigen::VectorXd::Constant(1, kPi));
  problem.u_lower_.setConstant(-4.0);  // gravity torque is 9.81 at the horizontal
  problem.u_upper_.setConstant(4.0);
  GnmsOptions options;
  options.max_iterations = 300;
  GnmsSolver solver(problem, options);
  const GnmsSummary summary = solver.Solve(Eigen::VectorXd::Zero(2));
  EXPECT_TRUE(summary.converged()) << summary.message << " iterations " << summary.iterations;
  EXPECT_NEAR(std::abs(solver.x(80)[0]), kPi, 0.05);
  EXPECT_LT(std::abs(solver.x(80)[1]), 0.1);
  EXPECT_LT(summary.max_defect, 1e-7);
  Eigen::VectorXd x = Eigen::VectorXd::Zero(2), next(2);
  for (int k = 0; k < 80; ++k) {  // the controls alone reproduce the states
    ASSERT_TRUE(problem.Step(k, x, solver.u(k), next));
    x = next;
    EXPECT_NEAR((x - solver.x(k + 1)).norm(), 0.0, 1e-4) << k;
    EXPECT_LE(std::abs(solver.u(k)[0]), 4.0);
  }
}

TEST(Gnms, DefectsCloseQuadratically) {
  Pendulum problem(25, 0.04, TrackingWeights::Uniform(1, 10.0, 0.1, 0.0, 1e-3, 100.0, 10.0));
  problem.cost().set_goal(Eigen::VectorXd::Constant(1, 2.5));
  GnmsSolver solver(problem, {});
  Eigen::MatrixXd guess = Eigen::MatrixXd::Zero(2, 26);
  guess.row(0).setLinSpaced(0.0, 2.5);
  solver.SetGuess(guess, Eigen::MatrixXd::Zero(1, 25));
  const GnmsSummary summary = solver.Solve(Eigen::VectorXd::Zero(2));
  ASSERT_TRUE(summary.converged());
  EXPECT_LE(summary.iterations, 10);
  const auto& history = solver.history();
  int checked = 0;
  for (size_t i = 1; i + 1 < history.size(); ++i) {
    if (history[i].step_length != 1.0 || history[i].step_x < 1e-5) continue;
    // The defect after a full step is second order in the step.
    EXPECT_LT(history[i + 1].max_defect, 10.0 * history[i].step_x * history[i].step_x) << i;
    ++checked;
  }
  EXPECT_GE(checked, 2);
}

TEST(Gnms, WarmShiftNeedsOnlyOneLinearisedKnotBeforeTheFirstStep) {
  Pendulum problem(25, 0.04, TrackingWeights::Uniform(1, 10.0, 0.1, 0.0, 1e-3, 100.0, 10.0));
  problem.cost().set_goal(Eigen::VectorXd::Constant(1, 1.0));
  GnmsSolver solver(problem, {});
  ASSERT_TRUE(solver.Solve(Eigen::VectorXd::Zero(2)).converged());
  const Eigen::VectorXd x1 = solver.x(1);
  solver.Shift();
  solver.set_max_iterations(1);
  problem.linearizations = 0;
  const GnmsSummary summary = solver.Solve(x1);
  EXPECT_EQ(problem.linearizations, 1 + 25);
  EXPECT_LT(summary.max_defect, 1e-3);
}

TEST(Gnms, InfeasibleStateBoxIsSaidToBeInfeasible) {
  DoubleIntegrators problem(1, 10, 0.04, TrackingWeights::Uniform(1, 10.0, 0.0, 0.0, 1e-3, 100.0, 10.0));
  problem.u_lower_.setConstant(-1.0);
  problem.u_upper_.setConstant(1.0);
  problem.x_upper_[1] = 0.5;
  GnmsSolver solver(problem, {});
  const GnmsSummary summary = solver.Solve(Eigen::Vector2d(0.0, 2.0));  // cannot brake in one knot
  EXPECT_EQ(summary.termination, Termination::kInfeasible);
  EXPECT_GT(summary.max_violation, 1.0);
  EXPECT_EQ(summary.worst_knot, 1);
  EXPECT_EQ(summary.worst_state, 1);
}

TEST(Gnms, NonFiniteGuessNamesTheKnot) {
  Pendulum problem(5, 0.04, TrackingWeights::Uniform(1, 1.0, 0.1, 0.0, 1e-3, 1.0, 1.0));
  GnmsSolver solver(problem, {});
  Eigen::MatrixXd x = Eigen::MatrixXd::Zero(2, 6);
  x(1, 3) = std::numeric_limits<double>::quiet_NaN();
  solver.SetGuess(x, Eigen::MatrixXd::Zero(1, 5));
  const GnmsSummary summary = solver.Solve(Eigen::VectorXd::Zero(2));
  EXPECT_EQ(summary.termination, Termination::kNonFinite);
  EXPECT_EQ(summary.worst_knot, 3);
  EXPECT_NE(summary.message.find("knot 3"), std::string::npos) << summary.message;
  EXPECT_NE(summary.message.find("pendulum is not finite"), std::string::npos) << summary.message;
}

// Each reading of the clock costs a second.
class SlowClock final : public Clock {
 public:
  int64_t SteadyNanos() const override { return now_ += 1'000'000'000; }
  int64_t WallNanos() const override { return now_; }

 private:
  mutable int64_t now_ = 0;
};

TEST(Gnms, StopsWithinItsTimeBudget) {
  Pendulum problem(80, 0.05, TrackingWeights::Uniform(1, 0.1, 0.01, 0.0, 1e-2, 300.0, 30.0));
  problem.cost().set_goal(Eigen::VectorXd::Constant(1, kPi));
  SlowClock clock;
  GnmsOptions options;
  options.time_budget_s = 10.0;
  GnmsSolver solver(problem, options, &clock);
  const GnmsSummary summary = solver.Solve(Eigen::VectorXd::Zero(2));
  EXPECT_EQ(summary.termination, Termination::kTimeBudget);
  EXPECT_GE(summary.iterations, 1);
  EXPECT_LE(summary.iterations, 4);
}

TEST(Gnms, SameInputSameBits) {
  auto solve = [] {
    Pendulum problem(30, 0.05, TrackingWeights::Uniform(1, 1.0, 0.01, 0.0, 1e-2, 30.0, 3.0));
    problem.cost().set_goal(Eigen::VectorXd::Constant(1, 2.0));
    problem.u_lower_.setConstant(-8.0);
    problem.u_upper_.setConstant(8.0);
    GnmsSolver solver(problem, {});
    EXPECT_TRUE(solver.Solve(Eigen::VectorXd::Zero(2)).converged());
    Eigen::MatrixXd u(1, 30);
    for (int k = 0; k < 30; ++k) u.col(k) = solver.u(k);
    return u;
  };
  EXPECT_EQ(solve(), solve());
}

}  // namespace
}  // namespace rg::trajectories
