#include "services/sysid/basin_hopping.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/unit/sysid/toy_residuals.h"

namespace rg::sysid {
namespace {

using Eigen::VectorXd;

struct Toy {
  testing::LambdaResiduals residuals = testing::Rastrigin(3);
  LeastSquaresProblem problem = testing::FreeProblem(&residuals, Eigen::Vector3d(3.9, -3.1, 2.9));
};

TEST(BasinHopping, EscapesALocalMinimumThatLevenbergMarquardtDoesNot) {
  Toy toy;
  const SolveSummary local = Solve(toy.problem, toy.problem.initial, {}, {});
  EXPECT_GT(local.cost, 10.0);
  HopOptions options;
  options.temperature = 0.3;
  const HopState s = RunHops(toy.problem, options, StartChain(1, 0), {.hops = 300}, RealClock());
  EXPECT_LT(s.best_cost, 1e-6);
  EXPECT_NEAR(s.history.front().cost, local.cost, 1e-6) << "chain 0 starts at p_init";
}

TEST(BasinHopping, ResumedFromItsCheckpointIsTheChainThatWasNotCut) {
  Toy toy;
  const HopState whole = RunHops(toy.problem, {}, StartChain(7, 2), {.hops = 20}, RealClock());
  HopState pieces = StartChain(7, 2);
  for (int k = 0; k < 4; ++k) {
    pieces = RunHops(toy.problem, {}, pieces, {.hops = 5}, RealClock());
    const auto parsed = ParseHopState(SerializeHopState(pieces));
    ASSERT_TRUE(parsed.ok()) << parsed.status().ToString();
    pieces = *parsed;
  }
  EXPECT_EQ(SerializeHopState(pieces), SerializeHopState(whole));
}

TEST(BasinHopping, AHopCutByCancelIsDoneAgain) {
  Toy toy;
  const HopState whole = RunHops(toy.problem, {}, StartChain(7, 2), {.hops = 6}, RealClock());
  CancelToken cancel;
  int evaluations = 0;
  testing::LambdaResiduals cancels(
      3, 6, [&](const VectorXd& p, const StopCondition& stop, VectorXd* r, RowMatrix* J) {
        if (++evaluations == 25) cancel.Cancel();
        return toy.residuals.Evaluate(p, stop, r, J);
      });
  LeastSquaresProblem problem = toy.problem;
  problem.residuals = &cancels;
  HopState cut = RunHops(problem, {}, StartChain(7, 2), {.hops = 6}, RealClock(), {}, &cancel);
  EXPECT_LT(cut.hops, 6);
  cut = RunHops(toy.problem, {}, cut, {.hops = 6 - cut.hops}, RealClock());
  EXPECT_DOUBLE_EQ(cut.best_cost, whole.best_cost);
  EXPECT_EQ(cut.history.size(), whole.history.size());
}

TEST(BasinHopping, KeepsItsTimeBudget) {
  Toy toy;
  FakeClock clock;
  testing::LambdaResiduals slow(3, 6,
                                [&](const VectorXd& p, const StopCondition& stop, VectorXd* r, RowMatrix* J) {
                                  clock.Advance(50'000'000);
                                  return toy.residuals.Evaluate(p, stop, r, J);
                                });
  LeastSquaresProblem problem = toy.problem;
  problem.residuals = &slow;
  const double start = clock.SteadySeconds();
  const HopState s = RunHops(problem, {}, StartChain(1, 0), {.seconds = 10.0}, clock);
  EXPECT_LE(clock.SteadySeconds() - start, 10.05 + 1e-9);
  EXPECT_GT(s.hops, 2);
}

TEST(BasinHopping, OtherChainsStartWithinTheSearchRangeAndDiffer) {
  Toy toy;
  HopOptions options;
  options.solve.max_iterations = 0;  // the start itself
  toy.problem.search_lower.setConstant(1.0);
  toy.problem.search_upper.setConstant(2.0);
  const HopState a = RunHops(toy.problem, options, StartChain(1, 1), {.hops = 1}, RealClock());
  const HopState b = RunHops(toy.problem, options, StartChain(1, 2), {.hops = 1}, RealClock());
  EXPECT_TRUE((a.current.array() >= 1.0).all() && (a.current.array() <= 2.0).all());
  EXPECT_GT((a.current - b.current).norm(), 0.01);
}

TEST(BasinHopping, ExchangeTakesOnlyABetterPoint) {
  Toy toy;
  HopState s = RunHops(toy.problem, {}, StartChain(1, 0), {.hops = 1}, RealClock());
  EXPECT_FALSE(Exchange(VectorXd::Zero(3), s.best_cost + 1.0, &s));
  EXPECT_TRUE(Exchange(VectorXd::Zero(3), 0.0, &s));
  EXPECT_EQ(s.current, VectorXd::Zero(3));
  EXPECT_EQ(s.best_cost, 0.0);
}

TEST(BasinHopping, StepSizeGrowsWhileEverythingIsAcceptedAndShrinksOtherwise) {
  Toy toy;
  auto flat = testing::Linear(Eigen::MatrixXd::Zero(1, 3), VectorXd::Zero(1));
  LeastSquaresProblem problem = testing::FreeProblem(&flat, VectorXd::Zero(3));
  const HopState grown = RunHops(problem, {}, StartChain(1, 0), {.hops = 20}, RealClock());
  EXPECT_GT(grown.step_size, StartChain(1, 0).step_size);
  HopOptions cold;
  cold.temperature = 1e-12;
  cold.solve.max_iterations = 0;
  problem = toy.problem;
  problem.initial.setZero();  // the global minimum: every hop is worse
  const HopState shrunk = RunHops(problem, cold, StartChain(1, 0), {.hops = 20}, RealClock());
  EXPECT_LT(shrunk.step_size, StartChain(1, 0).step_size);
}

TEST(BasinHopping, LaterIterationsStartFromTheLastOptimum) {
  Toy toy;
  const VectorXd last = Eigen::Vector3d(0.1, 0.0, -0.1);
  HopOptions options;
  options.solve.max_iterations = 0;
  const HopState s = RunHops(toy.problem, options, StartChainAt(3, 1, last, 1.0), {.hops = 1}, RealClock());
  EXPECT_EQ(s.current, last);
}

TEST(BasinHopping, RecordsWhereTheChainsOwnPointsBegan) {
  Toy toy;
  HopState s = RunHops(toy.problem, {}, StartChain(1, 0), {.hops = 2}, RealClock());
  double cost = 0.0;
  ASSERT_TRUE(EvaluateCost(toy.problem, toy.problem.initial, {}, &cost));
  EXPECT_DOUBLE_EQ(s.history[0].start, cost) << "chain 0 begins at p_init";
  EXPECT_GT(s.history[0].start, s.history[0].cost);
  EXPECT_TRUE(std::isinf(s.history[1].start)) << "a perturbed start is no point of the chain";
  ChangeCost(s.best_cost, &s);
  s = *ParseHopState(SerializeHopState(s));
  s = RunHops(toy.problem, {}, s, {.hops = 1}, RealClock());
  EXPECT_DOUBLE_EQ(s.history[0].start, cost);
  EXPECT_NEAR(s.history[2].start, s.history[1].best, 1e-9) << "on a new cost it begins at its best";
  EXPECT_TRUE(
      std::isinf(RunHops(toy.problem, {}, StartChain(1, 1), {.hops = 1}, RealClock()).history[0].start));
}

TEST(BasinHopping, ChainAgreesOnceThreeHopsCameToOneMinimum) {
  auto bowl = testing::Linear(Eigen::MatrixXd::Identity(4, 3), VectorXd::Constant(4, 1.0));
  const LeastSquaresProblem problem = testing::FreeProblem(&bowl, VectorXd::Zero(3));
  HopState s = RunHops(problem, {}, StartChain(1, 1), {.hops = 2}, RealClock());
  EXPECT_FALSE(Agrees(s));
  s = RunHops(problem, {}, s, {.hops = 1}, RealClock());
  EXPECT_TRUE(Agrees(s));
  EXPECT_FALSE(Agrees([s]() mutable { return Exchange(VectorXd::Zero(3), 0.9 * s.best_cost, &s), s; }()))
      << "another chain has a better one";

  ChangeCost(2 * s.best_cost, &s);
  EXPECT_FALSE(Agrees(s)) << "nothing was solved on the new cost";
  s = *ParseHopState(SerializeHopState(s));
  const HopState on = RunHops(problem, {}, s, {.hops = 1}, RealClock());
  EXPECT_TRUE(Agrees(on)) << "one hop, from the best point itself";
  EXPECT_EQ(on.history.back().cost, on.best_cost);
}

TEST(BasinHopping, ChainsAgreeTogetherAndOneGoesOnFromThePointThatIsItsOwn) {
  auto bowl = testing::Linear(Eigen::MatrixXd::Identity(4, 3), VectorXd::Constant(4, 1.0));
  const LeastSquaresProblem problem = testing::FreeProblem(&bowl, VectorXd::Zero(3));
  HopState a = RunHops(problem, {}, StartChain(1, 1), {.hops = 2}, RealClock());
  const HopState b = RunHops(problem, {}, StartChain(1, 2), {.hops = 2}, RealClock());
  const VectorXd own = a.best;
  EXPECT_EQ(ExchangeAll({a, b}, &a), -1) << "as good as its own";
  EXPECT_EQ(a.best, own);
  EXPECT_EQ(a.others.size(), 2u) << "its own state among them is no news";
  EXPECT_TRUE(Agrees(a));
  a = *ParseHopState(SerializeHopState(a));
  EXPECT_TRUE(Agrees(a));

  HopState worse = a;
  worse.best_cost *= 1.5;
  EXPECT_EQ(ExchangeAll({b, StartChain(1, 3)}, &worse), 2);
  EXPECT_EQ(worse.best, b.best);
  worse = *ParseHopState(SerializeHopState(worse));
  ChangeCost(2 * worse.best_cost, &worse);
  EXPECT_TRUE(Agrees(worse)) << "chain 2 goes on from there";
  ChangeCost(2 * a.best_cost, &a);
  EXPECT_FALSE(Agrees(a)) << "and this one from its own";
}

TEST(BasinHopping, ChainThatFallsIntoOneMinimumAfterAnotherDoesNotAgree) {
  Toy toy;
  HopOptions options;
  options.solve.max_iterations = 0;  // every hop ends where it began
  EXPECT_FALSE(Agrees(RunHops(toy.problem, options, StartChain(1, 1), {.hops = 20}, RealClock())));
}

TEST(HopState, RefusesWhatItDoesNotUnderstand) {
  EXPECT_FALSE(ParseHopState("{").ok());
  EXPECT_FALSE(ParseHopState(R"({"format": "realitygrad.hop_state/9"})").ok());
}

}  // namespace
}  // namespace rg::sysid
