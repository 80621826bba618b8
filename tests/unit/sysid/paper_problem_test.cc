#include "services/sysid/paper_problem.h"

#include <gtest/gtest.h>

#include <cmath>
#include <set>

#include "common/math/gradient_check.h"
#include "services/sysid/basin_hopping.h"
#include "tests/unit/sysid/simulated_recordings.h"

namespace rg::sysid {
namespace {

using Eigen::VectorXd;

struct Mico {
  sim::Plant plant = testing::LoadPlant("mico2");
  VectorXd nominal = plant.parameters().Nominal();
  // 25 Hz without noise, as the paper's arm is read.
  recordings::Recording Record(const VectorXd& values) const {
    return testing::MakeRecording(
        plant, values, 3,
        {.duration_s = 2.0, .rate_hz = 25.0, .amplitude = 0.2, .center = testing::CandlePose()});
  }
};

TEST(PaperProblem, HasThePapersSeventyOneParametersAndResidualsOnTheStepGrid) {
  Mico mico;
  const auto paper = PaperProblem::Create(mico.plant, mico.nominal, mico.Record(mico.nominal));
  ASSERT_TRUE(paper.ok()) << paper.status().ToString();
  EXPECT_EQ(paper->problem().residuals->num_parameters(), 71);
  EXPECT_EQ(paper->problem().residuals->num_residuals(), 200 * 6);
  EXPECT_NEAR(paper->times().back(), 0.2, 1e-12);
}

TEST(PaperProblem, BoundsAreThePapersAndFixWhatIsZero) {
  Mico mico;
  const auto paper = PaperProblem::Create(mico.plant, mico.nominal, mico.Record(mico.nominal));
  ASSERT_TRUE(paper.ok());
  const auto& problem = paper->problem();
  int fixed = 0;
  for (int i = 0; i < 71; ++i) {
    const auto& p = mico.plant.parameters()[paper->parameters()[i]];
    if (p.name == "gravity.z") {
      EXPECT_DOUBLE_EQ(problem.lower[i], -9.81 * 1.2);
      EXPECT_DOUBLE_EQ(problem.upper[i], -9.81 * 0.8);
    }
    if (p.kind == sim::ParameterKind::kDamping) {
      EXPECT_EQ(problem.upper[i], 18.0);
    }
    if (p.kind == sim::ParameterKind::kForceGain) {
      EXPECT_EQ(problem.lower[i], -1.5);
    }
    fixed += problem.lower[i] == problem.upper[i] ? 1 : 0;
  }
  // gravity x and y; mass and three inertias of world, root and end_effector.
  EXPECT_EQ(fixed, 2 + 3 * 4);
}

TEST(PaperProblem, BodiesTakeThePlaceOfRawMassesAndInertias) {
  Mico mico;
  PaperOptions options;
  options.consistent_inertias = true;
  const auto paper = PaperProblem::Create(mico.plant, mico.nominal, mico.Record(mico.nominal), options);
  ASSERT_TRUE(paper.ok()) << paper.status().ToString();
  const LeastSquaresProblem& problem = paper->problem();
  EXPECT_EQ(problem.residuals->num_parameters(), 3 + 2 * 6 + 10 * 6) << "six moving bodies";
  EXPECT_LT((paper->FullValues(problem.initial) - mico.nominal).cwiseAbs().maxCoeff(), 1e-9);

  const auto recording = mico.Record(1.1 * mico.nominal);
  const auto cost = [&](const PaperOptions& o) {
    const auto of_this = PaperProblem::Create(mico.plant, mico.nominal, recording, o);
    double value = 0.0;
    EXPECT_TRUE(EvaluateCost(of_this->problem(), of_this->problem().initial, {}, &value));
    return value;
  };
  EXPECT_NEAR(cost(options), cost({}), 1e-6 * cost({})) << "the same model at the start";
}

// The share holds for the mass and, at that mass, for the second moments; centres and axes stay.
TEST(PaperProblem, BoundsOfBodiesAreThePapersToo) {
  Mico mico;
  PaperOptions options;
  options.consistent_inertias = true;
  const auto paper = PaperProblem::Create(mico.plant, mico.nominal, mico.Record(mico.nominal), options);
  ASSERT_TRUE(paper.ok()) << paper.status().ToString();
  for (const VectorXd& corner : {paper->problem().lower, paper->problem().upper}) {
    const VectorXd values = paper->FullValues(corner);
    const double share = corner == paper->problem().upper ? 1.2 : 0.8;
    for (const int i : paper->parameters()) {
      const sim::Parameter& p = mico.plant.parameters()[i];
      const double tolerance = 1e-6 * std::abs(p.nominal) + 1e-12;
      double factor = 1.0;
      if (p.kind == sim::ParameterKind::kMass) factor = share;
      if (p.kind == sim::ParameterKind::kInertia) factor = share * share;
      if (factor == 1.0 && p.kind != sim::ParameterKind::kCenterOfMass) continue;
      EXPECT_NEAR(values[i], factor * p.nominal, tolerance) << p.name;
    }
  }
}

class PaperProblemJacobian : public ::testing::TestWithParam<bool> {};
INSTANTIATE_TEST_SUITE_P(RawAndBodies, PaperProblemJacobian, ::testing::Bool());

TEST_P(PaperProblemJacobian, MatchesCentralDifferences) {
  Mico mico;
  PaperOptions options_of_problem;
  options_of_problem.consistent_inertias = GetParam();
  auto paper = PaperProblem::Create(mico.plant, mico.nominal, mico.Record(mico.nominal), options_of_problem);
  ASSERT_TRUE(paper.ok());
  ResidualFunction& residuals = *paper->problem().residuals;
  const int P = residuals.num_parameters();
  VectorXd p = paper->problem().initial;
  // Away from the nominal bodies, where coordinates of one body hardly mix.
  for (int i = 0; i < P; ++i)
    if (!paper->space().IsItself(i)) p[i] += 0.05 * std::sin(3.0 * i);
  VectorXd r(residuals.num_residuals());
  RowMatrix J(residuals.num_residuals(), P);
  ASSERT_TRUE(residuals.Evaluate(p, {}, &r, &J));
  // In the solver's units, or the difference step would be larger than a finger's inertia.
  const VectorXd& scale = paper->problem().scale;
  const auto f = [&](const VectorXd& y) {
    VectorXd out(residuals.num_residuals());
    RG_CHECK(residuals.Evaluate(p + scale.cwiseProduct(y), {}, &out, nullptr));
    return out;
  };
  const Eigen::MatrixXd scaled = J * scale.asDiagonal();
  math::GradientCheckOptions options;
  options.scale_floor = 1e-2;
  options.tolerance = 1e-4;
  const auto result = math::CheckGradient(f, VectorXd::Zero(P), scaled, options);
  EXPECT_TRUE(result) << result.message;
}

TEST(PaperProblem, BoundedSolverExplainsAWindowOfAnotherRobotWithinItsBounds) {
  Mico mico;
  VectorXd truth = mico.nominal;
  for (const int i : PaperParameters(mico.plant)) {
    const auto& p = mico.plant.parameters()[i];
    if (p.kind == sim::ParameterKind::kMass) truth[i] *= 1.1;
    if (p.kind == sim::ParameterKind::kDamping) truth[i] = 0.5;
  }
  auto paper = PaperProblem::Create(mico.plant, mico.nominal, mico.Record(truth));
  ASSERT_TRUE(paper.ok());
  const auto& problem = paper->problem();
  double before = 0.0;
  ASSERT_TRUE(EvaluateCost(problem, problem.initial, {}, &before));
  const SolveSummary s = Solve(problem, problem.initial, {.max_iterations = 40}, {});
  // The rest is the paper's straight line between 25 Hz rows, which no parameter bends.
  EXPECT_LT(s.residual, 0.02 * before);
  EXPECT_TRUE((s.p.array() >= problem.lower.array()).all());
  EXPECT_TRUE((s.p.array() <= problem.upper.array()).all());
  const VectorXd full = paper->FullValues(s.p);
  EXPECT_TRUE(full.allFinite());
}

TEST(PaperProblem, ChainsOfBasinHoppingRunOnIt) {
  Mico mico;
  VectorXd truth = mico.nominal;
  for (const int i : mico.plant.parameters().OfKind(sim::ParameterKind::kDamping)) truth[i] = 2.0;
  auto paper = PaperProblem::Create(mico.plant, mico.nominal, mico.Record(truth));
  ASSERT_TRUE(paper.ok());
  HopOptions options;
  options.solve.max_iterations = 5;
  for (const Solver solver : {Solver::kBoundedLevenbergMarquardt, Solver::kUnboundedLbfgs}) {
    options.solve.solver = solver;
    const HopState s = RunHops(paper->problem(), options, StartChain(1, 0), {.hops = 2}, RealClock());
    EXPECT_EQ(s.hops, 2);
    double before = 0.0;
    ASSERT_TRUE(EvaluateCost(paper->problem(), paper->problem().initial, {}, &before));
    EXPECT_LT(s.best_cost, before);
  }
}

// Windows of one length go side by side, the longer one alone.
TEST(PaperProblem, WindowsAreSummedWithTheirWeights) {
  Mico mico;
  const recordings::Recording recording = mico.Record(mico.nominal);
  VectorXd other = mico.nominal;
  for (int i = 0; i < other.size(); ++i) {
    if (mico.plant.parameters()[i].kind == sim::ParameterKind::kDamping) other[i] += 0.5;
  }
  PaperOptions all;
  all.interpolate = false;
  all.windows = {{0.0, 0.5}, {0.5, 0.5}, {1.0, 0.5}, {0.0, 2.0, 0.3}};
  const auto together = PaperProblem::Create(mico.plant, other, recording, all);
  ASSERT_TRUE(together.ok()) << together.status().ToString();
  EXPECT_EQ(together->windows(), 4);
  ResidualFunction& sum = *together->problem().residuals;
  VectorXd r(sum.num_residuals());
  RowMatrix J(sum.num_residuals(), sum.num_parameters());
  ASSERT_TRUE(sum.Evaluate(together->problem().initial, {}, &r, &J));
  int row = 0;
  for (const PaperWindow& window : all.windows) {
    PaperOptions one = all;
    one.windows = {{window.start_s, window.length_s}};
    const auto alone = PaperProblem::Create(mico.plant, other, recording, one);
    ResidualFunction& part = *alone->problem().residuals;
    const int m = part.num_residuals();
    VectorXd part_r(m);
    RowMatrix part_J(m, part.num_parameters());
    ASSERT_TRUE(part.Evaluate(alone->problem().initial, {}, &part_r, &part_J));
    ASSERT_GT(part_r.norm(), 1e-4);
    EXPECT_LT((r.segment(row, m) - std::sqrt(window.weight) * part_r).norm(), 1e-9 * part_r.norm());
    EXPECT_LT((J.middleRows(row, m) - std::sqrt(window.weight) * part_J).norm(), 1e-8 * part_J.norm());
    row += m;
  }
  EXPECT_EQ(row, r.size());
}

TEST(PaperProblem, RefusesAWindowOutsideTheRecording) {
  Mico mico;
  PaperOptions options;
  options.windows = {{.start_s = 100.0}};
  const auto paper = PaperProblem::Create(mico.plant, mico.nominal, mico.Record(mico.nominal), options);
  ASSERT_FALSE(paper.ok());
  EXPECT_NE(paper.status().message().find("fewer than two rows"), std::string::npos);
}

}  // namespace
}  // namespace rg::sysid
