#include "services/sysid/fit_space.h"

#include <gtest/gtest.h>

#include "common/base/rng.h"
#include "common/math/gradient_check.h"
#include "services/sysid/drive_signal.h"
#include "services/sysid/identifiability.h"
#include "tests/unit/sysid/simulated_recordings.h"

namespace rg::sysid {
namespace {

using Eigen::VectorXd;

VectorXd RandomTheta(const FitSpace& space, uint64_t seed) {
  Rng rng(seed);
  VectorXd theta = space.nominal();
  for (int i = 0; i < theta.size(); ++i) theta[i] += rng.Normal() * std::min(0.5, space.prior_stddev()[i]);
  return theta;
}

TEST(FitSpace, ZeroIsTheUrdf) {
  const sim::Plant plant = testing::LoadPlant("arm2");
  const FitSpace space(InertialFitParameters(plant));
  const VectorXd p = space.Parameters(space.nominal());
  for (int i = 0; i < space.size(); ++i) {
    EXPECT_NEAR(p[i], space.parameters()[i].nominal, 1e-12) << space.parameters()[i].name;
    EXPECT_FALSE(space.IsItself(i));
  }
}

TEST(FitSpace, EveryPointIsABodyThatCanExist) {
  const sim::Plant plant = testing::LoadPlant("mico2");
  const FitSpace space(InertialFitParameters(plant));
  for (uint64_t seed = 0; seed < 50; ++seed) {
    const VectorXd values = space.Values(RandomTheta(space, seed), plant.parameters().Nominal());
    const auto links = LinkParametersOf(plant, values);
    std::vector<LinkInertia> inertias;
    for (int i = 0; i < links.cols(); ++i) {
      if (plant.model().link(i).body < 0 || links(0, i) < 0.1) continue;  // links that are not fitted
      inertias.push_back({plant.model().link(i).name, links(0, i), model::InertiaMatrix(links.col(i))});
    }
    EXPECT_EQ(inertias.size(), 6u);
    EXPECT_TRUE(ImpossibleInertias(inertias).empty());
  }
}

TEST(FitSpace, JacobianMatchesCentralDifferences) {
  const sim::Plant plant = testing::LoadPlant("arm2", {effects::MakeSpec("coulomb_friction", {"elbow"})});
  auto parameters = InertialFitParameters(plant);
  for (const FitParameter& p : EffectFitParameters(plant)) parameters.push_back(p);
  const FitSpace space(parameters);
  EXPECT_TRUE(space.IsItself(space.size() - 1));
  const VectorXd theta = RandomTheta(space, 3);
  const auto f = [&](const VectorXd& x) { return space.Parameters(x); };
  const auto result = math::CheckGradient(f, theta, space.Jacobian(theta));
  EXPECT_TRUE(result) << result.message;
  RowMatrix J = RowMatrix::Random(7, space.size());
  const RowMatrix expected = J * space.Jacobian(theta);
  space.PullBack(theta, &J);
  EXPECT_LT((J - expected).norm(), 1e-12 * expected.norm());
}

TEST(FitSpace, AnyValuesOfBodiesHaveTheirPoint) {
  const sim::Plant plant = testing::LoadPlant("mico2");
  auto parameters = InertialFitParameters(plant);
  for (const FitParameter& p : DeclaredJointFitParameters(plant)) parameters.push_back(p);
  const FitSpace space(parameters);
  const VectorXd nominal = plant.parameters().Nominal();
  EXPECT_LT((space.At(nominal) - space.nominal()).cwiseAbs().maxCoeff(), 1e-9);
  for (uint64_t seed = 0; seed < 20; ++seed) {
    // Not thinner than what is lifted.
    const VectorXd theta = RandomTheta(space, seed).cwiseMax(-0.5);
    EXPECT_LT((space.At(space.Values(theta, nominal)) - theta).cwiseAbs().maxCoeff(), 1e-6);
  }
}

TEST(FitSpace, RawSpaceIsTheParametersThemselves) {
  const sim::Plant plant = testing::LoadPlant("arm2");
  const FitSpace space(InertialFitParameters(plant), false);
  const VectorXd theta = RandomTheta(space, 3);
  EXPECT_EQ(space.Parameters(theta), theta);
}

TEST(FitSpace, AnInertiaNoBodyCanHaveIsLiftedToOneThatCan) {
  std::vector<FitParameter> parameters;
  const double thin[] = {1.0, 0.0, 0.0, 0.2, 0.02, 0.02, 0.0, 0.0, 0.0, 0.0};  // an ideal rod
  for (int k = 0; k < 10; ++k) {
    parameters.push_back(
        {k, std::string(model::kLinkParameterNames[k]) + ".rod", "", thin[k], -1e9, 1e9, 0.1});
  }
  const FitSpace space(parameters);
  const VectorXd p = space.Parameters(space.nominal());
  EXPECT_NEAR(p[0], 1.0, 1e-12);
  EXPECT_NEAR(p[3], 0.2, 1e-12);
  EXPECT_NEAR(p[6], 2.0 * kMinSpread * kMinSpread, 1e-9);

  // Not as the nominal link, but as what a fit begins at; and without mass it begins at the nominal one.
  VectorXd values = p;
  values.segment<3>(4) << 1.0, 1.0, 2.5;
  const VectorXd lifted = space.Parameters(space.At(values));
  EXPECT_TRUE(ImpossibleInertias({{"rod", lifted[0], lifted.segment<3>(4).asDiagonal()}}).empty());
  EXPECT_NEAR(lifted[4], 1.25, 1e-5);
  EXPECT_NEAR(lifted[6], 2.5, 1e-5);
  values[0] = 0.0;
  EXPECT_EQ(space.At(values), space.nominal());
}

TEST(FitSpace, TakesAProblemsPointBoundsAndPrior) {
  const sim::Plant plant = testing::LoadPlant("arm2");
  const FitSpace space(InertialFitParameters(plant));
  LeastSquaresProblem problem;
  problem.initial = RandomTheta(space, 1);
  problem.lower = problem.initial.array() - 0.1, problem.upper = problem.initial.array() + 0.2;
  problem.scale = VectorXd::Constant(space.size(), 0.3);
  const FitSpace other = space.With(problem);
  EXPECT_EQ(other.nominal(), problem.initial);
  EXPECT_EQ(other.lower(), problem.lower);
  EXPECT_EQ(other.upper(), problem.upper);
  EXPECT_EQ(other.prior_stddev(), problem.scale);
  EXPECT_EQ(other.Parameters(problem.initial), space.Parameters(problem.initial)) << "the same coordinates";
}

}  // namespace
}  // namespace rg::sysid
