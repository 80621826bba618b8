#include "services/diagnosis/likelihood/held_out.h"

#include <gtest/gtest.h>

#include <cmath>

#include "services/diagnosis/data/prepare_data.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/own_chi2.h"
#include "services/diagnosis/search/held_out_judge.h"
#include "tests/unit/diagnosis/prepared_set.h"

namespace rg::diagnosis {
namespace {

using effects::MakeSpec;

class HeldOutTest : public ::testing::Test {
 protected:
  void SetUp() override {
    p_ = testing::Prepare("pendulum", {MakeSpec("coulomb_friction", {Pivot()}, {{"coulomb", 0.15}})}, 41);
    p_->data.held_out = PrepareHeldOut(p_->set, p_->data, p_->nominal, p_->options);
    RG_CHECK(p_->data.held_out != nullptr);
  }
  static std::string Pivot() { return sysid::testing::LoadPlant("pendulum").joint_names()[0]; }

  Candidate Fitted(const std::vector<effects::EffectSpec>& specs, bool base = false) const {
    Candidate c;
    c.specs = specs, c.base = base;
    auto plant = sim::Plant::Create(p_->nominal.shared_model(), p_->nominal.options(), specs);
    RG_CHECK(plant.ok()) << plant.status().ToString();
    c.plant = std::make_shared<const sim::Plant>(*plant);
    c.parameters = FreeParameters(*c.plant, p_->scales, base);
    c.fit = Fit(p_->data, FitModel{*c.plant, c.plant->parameters().Nominal(), c.parameters}, options_);
    RG_CHECK(c.fit.ok);
    return c;
  }
  // As it is, with nothing fitted but how windows begin.
  Candidate AsGiven(const std::vector<effects::EffectSpec>& specs) const {
    Candidate c;
    c.specs = specs;
    auto plant = sim::Plant::Create(p_->nominal.shared_model(), p_->nominal.options(), specs);
    RG_CHECK(plant.ok()) << plant.status().ToString();
    c.plant = std::make_shared<const sim::Plant>(*plant);
    c.fit = Fit(p_->data, FitModel{*c.plant, c.plant->parameters().Nominal(), {}}, options_);
    RG_CHECK(c.fit.ok);
    return c;
  }
  HeldOut Of(const Candidate& c) const { return PredictHeldOut(*p_->data.held_out, c, options_); }

  std::unique_ptr<testing::Prepared> p_;
  LiftedOptions options_;
};

TEST_F(HeldOutTest, TheTrueLawIsShortOfNothingAndAnotherIsSurelyWorse) {
  const HeldOut right = Of(Fitted({MakeSpec("coulomb_friction", {Pivot()}, {{"coulomb", 0.1}})}));
  const HeldOut wrong = Of(Fitted({MakeSpec("viscous_friction", {Pivot()}, {{"viscous", 0.05}})}));
  EXPECT_LT(std::abs(right.deficit), 3 * right.deficit_stddev);
  EXPECT_GT(wrong.deficit, 10 * wrong.deficit_stddev);
  EXPECT_GT(right.log_density, wrong.log_density + 100);
}

TEST_F(HeldOutTest, AJudgeIsAskedOftenAndPredictsOnce) {
  const Candidate right = Fitted({MakeSpec("coulomb_friction", {Pivot()}, {{"coulomb", 0.1}})});
  const Candidate wrong = Fitted({MakeSpec("viscous_friction", {Pivot()}, {{"viscous", 0.05}})});
  const Trace trace(RealClock());
  HeldOutJudge judge(*p_->data.held_out, options_, trace);
  EXPECT_TRUE(judge.Holds(right, 0));
  EXPECT_FALSE(judge.Holds(wrong, 0));
  EXPECT_TRUE(judge.ExplainsMost(right, wrong));
  EXPECT_GT(judge.TakeWork(), 0);
  EXPECT_EQ(judge.WorstRecording(right, 0), -1);
  EXPECT_GE(judge.WorstRecording(wrong, 0), 0);
  EXPECT_EQ(judge.TakeWork(), 0) << "both were predicted before";

  // The same name with other values, and the same values at another noise, are other questions.
  Candidate longer = right;
  longer.fit.values *= 1.01;
  judge.Holds(longer, 0);
  EXPECT_GT(judge.TakeWork(), 0);
  options_.noise_scale = 2;
  judge.Holds(right, 0);
  EXPECT_GT(judge.TakeWork(), 0);
}

// Fit and prediction together are the evidence of all recordings.
TEST_F(HeldOutTest, AJudgePutsWhatIsLikelierInAllInTheBestsPlace) {
  Candidate right = Fitted({MakeSpec("coulomb_friction", {Pivot()}, {{"coulomb", 0.1}})});
  Candidate wrong = Fitted({MakeSpec("viscous_friction", {Pivot()}, {{"viscous", 0.05}})});
  const Trace trace(RealClock());
  HeldOutJudge judge(*p_->data.held_out, options_, trace);
  double needed = 0;
  const auto chosen = [&](const Candidate& best, const Candidate& rival) {
    SearchResult search;
    search.best = best, search.tried = {best, rival};
    judge.CompareRivals(&search, [&](const Candidate&, const Candidate&) { return needed; });
    EXPECT_TRUE(search.best.held_out.has_value());
    return search.best.specs[0].id;
  };
  right.score = -1000, wrong.score = -980;
  EXPECT_EQ(chosen(wrong, right), "coulomb_friction") << "what it predicts makes up for the fit";
  EXPECT_EQ(chosen(right, wrong), "coulomb_friction");
  right.score = -1e6;
  EXPECT_EQ(chosen(wrong, right), "viscous_friction") << "this fit nothing makes up for";
  Candidate richer = Fitted({MakeSpec("stribeck_friction", {Pivot()},
                                      {{"coulomb", 0.1}, {"static", 0.11}, {"stribeck_velocity", 0.1}})});
  richer.score = wrong.score;
  EXPECT_EQ(chosen(wrong, richer), "stribeck_friction");
  needed = 1e6;
  EXPECT_EQ(chosen(wrong, richer), "viscous_friction") << "a richer form must bring what it needs";
  richer.form = needed;
  EXPECT_EQ(chosen(wrong, richer), "stribeck_friction") << "what its score is less by already";
}

TEST_F(HeldOutTest, OfStatesThatNoSensorReadsAJudgeAsksMore) {
  // Either leaves about a quarter of what the true law, of 0.15 N·m, explains.
  const Candidate without = AsGiven({});
  const Candidate law = AsGiven({MakeSpec("coulomb_friction", {Pivot()}, {{"coulomb", 0.08}})});
  const Candidate hidden =
      AsGiven({MakeSpec("presliding_hysteresis", {Pivot()},
                        {{"coulomb", 0.08}, {"bristle_stiffness", 200.0}, {"bristle_damping", 0.5}})});
  ASSERT_TRUE(HasHiddenStates(hidden));
  const Trace trace(RealClock());
  HeldOutJudge judge(*p_->data.held_out, options_, trace);
  EXPECT_TRUE(judge.ExplainsMost(law, without));
  EXPECT_FALSE(judge.ExplainsMost(hidden, without));
}

TEST_F(HeldOutTest, WhatTheFitLeftOpenCostsNoMoreThanItsUncertainty) {
  // Masses and inertias that one joint cannot tell apart, free beside the true law.
  const HeldOut lean = Of(Fitted({MakeSpec("coulomb_friction", {Pivot()}, {{"coulomb", 0.1}})}));
  const HeldOut free = Of(Fitted({MakeSpec("coulomb_friction", {Pivot()}, {{"coulomb", 0.1}})}, true));
  EXPECT_NEAR(lean.log_density, free.log_density, 10);
}

TEST_F(HeldOutTest, HiddenStatesThatAreChosenInEachWindowPredictNothing) {
  // A mass that swings as it likes follows much when it may start anew in each window.
  const Candidate swing =
      AsGiven({MakeSpec("sloshing_payload", {}, {{"mass", 0.05}, {"stiffness", 1.0}, {"damping", 1e-4}})});
  const HeldOut kept = Of(swing);
  const FitResult chosen = Fit(*p_->data.held_out, FitModel{*swing.plant, swing.fit.values, {}}, options_);
  EXPECT_LT(kept.log_density, -0.5 * chosen.chi2 - 10);
}

// Carried along the record, a stiff spring would be struck by the noise of every row.
TEST_F(HeldOutTest, ATrueSpringGoesOnAsTheWindowBeforeLeftIt) {
  const effects::EffectSpec spring = MakeSpec(
      "joint_elasticity", {Pivot()}, {{"stiffness", 800.0}, {"damping", 0.3}, {"motor_inertia", 0.05}});
  p_ = testing::Prepare("pendulum", {spring}, 42);
  p_->data.held_out = PrepareHeldOut(p_->set, p_->data, p_->nominal, p_->options);
  const HeldOut right = Of(Fitted({spring}));
  EXPECT_LT(right.deficit, 5 * right.deficit_stddev);
}

TEST_F(HeldOutTest, AModelsOwnMisfitIsThatOfItsRecordings) {
  const Candidate right = Fitted({MakeSpec("coulomb_friction", {Pivot()}, {{"coulomb", 0.1}})});
  const FitModel model{*right.plant, right.fit.values, {}};
  const double own = OwnChi2(p_->data, model, right.fit.states, options_, Rng(3));
  const double scatter = std::sqrt(4.0 * right.fit.rows);
  EXPECT_NEAR(own, right.fit.chi2, 3 * scatter);
  const Candidate wrong = Fitted({MakeSpec("viscous_friction", {Pivot()}, {{"viscous", 0.05}})});
  const FitModel other{*wrong.plant, wrong.fit.values, {}};
  EXPECT_GT(wrong.fit.chi2, OwnChi2(p_->data, other, wrong.fit.states, options_, Rng(3)) + 10 * scatter);
}

}  // namespace
}  // namespace rg::diagnosis
