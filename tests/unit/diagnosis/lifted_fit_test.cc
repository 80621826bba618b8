#include "services/diagnosis/lifted_fit.h"

#include <gtest/gtest.h>

#include <tuple>

#include "services/diagnosis/gram.h"
#include "services/diagnosis/hypotheses.h"
#include "services/diagnosis/search.h"
#include "services/sysid/sysid_on_set.h"
#include "tests/unit/diagnosis/simulated_set.h"

namespace rg::diagnosis {
namespace {

using effects::MakeSpec;

struct Prepared {
  recordings::RecordingSet set;
  sim::Plant nominal;
  FitData data;
  MotionScales scales;
  DiagnosisOptions options;
};

std::unique_ptr<Prepared> Prepare(const std::string& robot, std::vector<effects::EffectSpec> effects,
                                  uint64_t seed) {
  recordings::RecordingSet set = testing::MakeSet(robot, std::move(effects), seed);
  auto nominal = sysid::NominalPlant(set);
  RG_CHECK(nominal.ok()) << nominal.status().ToString();
  auto out = std::make_unique<Prepared>(Prepared{std::move(set), *nominal, {}, {}, {}});
  auto data = PrepareData(out->set, out->nominal, out->options);
  RG_CHECK(data.ok()) << data.status().ToString();
  out->data = *data;
  out->scales = ScalesOf(out->data, out->nominal);
  return out;
}

FitResult FitEffects(const Prepared& p, std::vector<effects::EffectSpec> specs) {
  auto plant = sim::Plant::Create(p.nominal.shared_model(), p.nominal.options(), std::move(specs));
  RG_CHECK(plant.ok()) << plant.status().ToString();
  return Fit(p.data, {*plant, plant->parameters().Nominal(), FreeParameters(*plant, p.scales, false)}, {});
}

TEST(LiftedFit, TheTrueModelIsAtTheNoise) {
  const auto p = Prepare("pendulum", {}, 1);
  const FitResult fit = FitEffects(*p, {});
  ASSERT_TRUE(fit.ok);
  // Rows minus the unknown initial states.
  const double dof = fit.rows - 2.0 * static_cast<double>(p->data.windows.size());
  EXPECT_NEAR(fit.chi2 / dof, 1.0, 5.0 * std::sqrt(2.0 / dof));
}

TEST(LiftedFit, FindsCoulombFrictionThroughSticking) {
  const std::string joint = sysid::testing::LoadPlant("pendulum").joint_names()[0];
  const auto p = Prepare("pendulum", {MakeSpec("coulomb_friction", {joint}, {{"coulomb", 0.15}})}, 2);
  const FitResult wrong = FitEffects(*p, {});
  const FitResult fit = FitEffects(*p, {MakeSpec("coulomb_friction", {joint}, {{"coulomb", 0.05}})});
  ASSERT_TRUE(fit.ok);
  EXPECT_NEAR(fit.theta[0], 0.15, 5 * fit.stddev[0] + 1e-3);
  EXPECT_GT(fit.evidence, wrong.evidence + 50);
}

TEST(LiftedFit, DoesNotDependOnTheNumberOfThreads) {
  const auto p = Prepare("pendulum", {}, 3);
  LiftedOptions one, three;
  three.threads = 3;
  const FitModel model{p->nominal, p->nominal.parameters().Nominal(),
                       FreeParameters(p->nominal, p->scales, true)};
  EXPECT_EQ(Fit(p->data, model, one).chi2, Fit(p->data, model, three).chi2);
}

TEST(Gram, IsWhatEigenSaysForEverySize) {
  Rng rng(3);
  for (const auto& [rows, a, b] : {std::tuple{1, 1, 1}, {70, 9, 21}, {130, 37, 64}}) {
    RowMatrixXd A(rows, a), B(rows, b), G = RowMatrixXd::Ones(a, b), H = RowMatrixXd::Zero(a, a);
    for (double& x : A.reshaped()) x = rng.Normal();
    for (double& x : B.reshaped()) x = rng.Normal();
    AddTransposedProduct(A, B, 0.5, &G);
    EXPECT_LT((G - RowMatrixXd::Ones(a, b) - 0.5 * A.transpose() * B).norm(), 1e-11 * rows);
    AddGram(A, 2.0, &H);
    const RowMatrixXd lower = H.triangularView<Eigen::Lower>(), product = 2.0 * A.transpose() * A;
    EXPECT_LT((lower - RowMatrixXd(product.triangularView<Eigen::Lower>())).norm(), 1e-11 * rows);
  }
}

TEST(Screening, TheInjectedEffectScoresAboveTheNullAndNothingDoesWithoutIt) {
  const std::string joint = sysid::testing::LoadPlant("pendulum").joint_names()[0];
  for (const bool there : {true, false}) {
    const auto p = Prepare(
        "pendulum",
        there ? std::vector<effects::EffectSpec>{MakeSpec("viscous_friction", {joint}, {{"viscous", 0.1}})}
              : std::vector<effects::EffectSpec>{},
        4);
    const FeatureSet features = MakeFeatures(p->data, p->scales);
    const FitModel model{p->nominal, p->nominal.parameters().Nominal(), {}};
    const NodeStates states = InitialStates(p->data, model, {});
    const auto step_rule = StepRuleResiduals(p->data, model, states, {});
    const Screen screen = MakeScreen(p->data, model, states, features.block, {}, step_rule, 60, Rng(5));
    const ScreenResult result = ScoreHypotheses(screen, {}, features, p->scales, false, 1);
    ASSERT_FALSE(result.hypotheses.empty());
    if (there) {
      EXPECT_GT(result.hypotheses.front().gain, result.null_gain + 20);
      double viscous = 0;
      for (const Scored& h : result.hypotheses) {
        if (h.effect == "viscous_friction") viscous = h.coefficients[0];
      }
      EXPECT_NEAR(viscous, 0.1, 0.02);
    } else {
      EXPECT_LT(result.hypotheses.front().gain, std::max(result.null_gain, 0.0) + 6);
    }
  }
}

TEST(MissingForce, ShowsAConstantPush) {
  const std::string joint = sysid::testing::LoadPlant("pendulum").joint_names()[0];
  const auto p = Prepare(
      "pendulum",
      {MakeSpec("external_disturbance", {joint}, {{"start", 1.0}, {"end", 3.0}, {"torque", 0.3}})}, 6);
  const FitModel model{p->nominal, p->nominal.parameters().Nominal(), {}};
  const MissingForce force =
      EstimateMissingForce(p->data, model, InitialStates(p->data, model, {}), p->scales.torque, 0.1, {});
  double inside = 0, outside = 0;
  int count_inside = 0, count_outside = 0;
  for (size_t w = 0; w < force.force.size(); ++w) {
    for (size_t s = 0; s < force.t[w].size(); ++s) {
      const double t = force.t[w][s];
      if (t > 1.1 && t < 2.9) inside += force.force[w](0, static_cast<long>(s)), ++count_inside;
      if (t < 0.9 || t > 3.1) outside += force.force[w](0, static_cast<long>(s)), ++count_outside;
    }
  }
  EXPECT_NEAR(inside / count_inside, 0.3, 0.05);
  EXPECT_NEAR(outside / count_outside, 0.0, 0.05);
}

TEST(Hypotheses, ANewFrictionTakesThePlaceOfTheOld) {
  const auto specs = Joined({MakeSpec("coulomb_friction", {"a"}), MakeSpec("coulomb_friction", {"b"})},
                            {MakeSpec("stribeck_friction", {"a"})});
  ASSERT_EQ(specs.size(), 2u);
  EXPECT_EQ(specs[0].joints[0], "b");
  EXPECT_EQ(specs[1].id, "stribeck_friction");
}

}  // namespace
}  // namespace rg::diagnosis
