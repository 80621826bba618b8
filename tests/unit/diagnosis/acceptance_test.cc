#include "services/diagnosis/screening/acceptance.h"

#include <gtest/gtest.h>

#include "services/diagnosis/hypotheses/hypotheses.h"
#include "tests/unit/diagnosis/prepared_set.h"

namespace rg::diagnosis {
namespace {

using effects::MakeSpec;

Candidate Model(std::vector<effects::EffectSpec> specs, bool base = false) {
  Candidate c;
  c.specs = std::move(specs), c.base = base;
  c.fit.rows = 800;
  return c;
}

// By noise that is the sensors' own.
Misfit Left(double nats) { return {nats, nats}; }

ScreenResult StepRuleOf(const std::string& effect, int joint, double nats) {
  ScreenResult s;
  Scored h;
  h.effect = effect, h.joints = {joint}, h.step_rule = nats;
  s.hypotheses.push_back(h);
  return s;
}

TEST(Acceptance, ANameBesideOthersNeedsAShareOfWhatTheyExplain) {
  const Acceptance acceptance;
  EXPECT_LT(acceptance.Needed(Model({}), 0, Left(1e6)), 10);
  EXPECT_DOUBLE_EQ(acceptance.Needed(Model({MakeSpec("payload", {})}), 1e5, Left(1e6)), 1e3);
}

TEST(Acceptance, WhatTakesHalfOfAllThatIsLeftIsNoMatterOfForm) {
  const Acceptance acceptance;
  // One percent would be 10,000 nats: more than there is to be had.
  const double needed = acceptance.Needed(Model({MakeSpec("payload", {})}), 1e6, Left(600));
  EXPECT_DOUBLE_EQ(needed, 0.5 * (600 + 20));
  // Nothing at stake: the scatter of χ² remains.
  EXPECT_DOUBLE_EQ(acceptance.Needed(Model({MakeSpec("payload", {})}), 1e5, Left(-50)), 0.5 * 20);
}

TEST(Acceptance, HalfOfAllThatIsLeftIsNoMatterOfTheStepRuleEither) {
  Acceptance acceptance;
  acceptance.Note(StepRuleOf("load_dependent_friction", 0, 200), {"a"});
  const Candidate found = Model({MakeSpec("payload", {})}),
                  more = Model({MakeSpec("load_dependent_friction", {"a"})});
  EXPECT_DOUBLE_EQ(acceptance.Needed(found, 1e6, Left(6000), more), 0.5 * (6000 + 20));
  // But what the step rule may pretend is needed however little is left.
  EXPECT_GT(acceptance.Needed(found, 1e6, Left(100), more), 200);
}

TEST(Acceptance, AroundAModelThatIsFarOffAStepRuleAsksNoMoreThanHalfOfWhatIsLeft) {
  Acceptance acceptance;
  acceptance.Note(StepRuleOf("position_spring", 0, 3e5), {"a"});
  const Candidate more = Model({MakeSpec("position_spring", {"a"})});
  EXPECT_DOUBLE_EQ(acceptance.Needed(Model({}), 0, Left(1e5), more), 0.5 * (1e5 + 20));
  EXPECT_DOUBLE_EQ(acceptance.Needed(Model({MakeSpec("payload", {})}), 1e4, Left(1e5), more),
                   0.5 * (1e5 + 20));
  // Nearer to it the step rule is what it says.
  EXPECT_GT(acceptance.Needed(Model({}), 0, Left(1e3), more), 3e5);
}

TEST(Acceptance, WhatExplainsLessThanNothingNeedsNoMoreThanChance) {
  const Acceptance acceptance;
  const double chance = acceptance.Needed(Model({}), 0, Left(0));
  EXPECT_DOUBLE_EQ(acceptance.Needed(Model({MakeSpec("payload", {})}), -5, Left(600)), chance);
  EXPECT_DOUBLE_EQ(acceptance.Needed(Model({MakeSpec("payload", {})}), -1e300, Left(0)), chance);
}

// They are many, and what they took up shows as the same laws on other joints once they are fixed.
TEST(Acceptance, FreeBaseParametersThatExplainAllGiveWayToTheSameKindsOfEffects) {
  const Candidate freed = Model({MakeSpec("torque_gain", {"a"})}, true),
                  alike = Model({MakeSpec("torque_gain", {"b"}), MakeSpec("torque_gain", {"c"})}),
                  other = Model({MakeSpec("torque_ripple", {"b"})});
  EXPECT_LT(Acceptance().Needed(freed, 1e6, Left(-50), alike), 5);
  EXPECT_GT(Acceptance().Needed(freed, 1e6, Left(-50), other), 50);
  const Candidate field = Model({MakeSpec("unknown_field", {"a"})}, true),
                  fields = Model({MakeSpec("unknown_field", {"a"}), MakeSpec("unknown_field", {"b"})});
  EXPECT_GT(Acceptance().Needed(field, 1e6, Left(-50), fields), 50) << "which fit nearly anything";
  EXPECT_GT(Acceptance().Needed(freed, 1e6, Left(1e3), alike), 500) << "while it lacks something";
  EXPECT_GT(Acceptance().Needed(alike, 1e6, Left(-50), freed), 50);
}

TEST(Acceptance, OnePercentOfAnAmplitudeIsNoNameHoweverLittleIsLeft) {
  EXPECT_DOUBLE_EQ(Acceptance().Needed(Model({MakeSpec("payload", {})}), 1e7, Left(-50)), 1e3);
}

TEST(Acceptance, WhatTakesNearlyAllOfASignificantMisfitIsNoErrorOfAnAmplitude) {
  // The misfit is 60 standard deviations of χ², and of 10⁷ nats explained a ten thousandth would be as much.
  EXPECT_DOUBLE_EQ(Acceptance().Needed(Model({MakeSpec("payload", {})}), 1e7, Left(1200)),
                   0.75 * (1200 + 20));
  // What is taken for noise may be that misfit.
  EXPECT_DOUBLE_EQ(Acceptance().Needed(Model({MakeSpec("payload", {})}), 1e7, {10, 1200}),
                   0.75 * (1200 + 20));
  // Two standard deviations may be chance.
  EXPECT_DOUBLE_EQ(Acceptance().Needed(Model({MakeSpec("payload", {})}), 1e7, Left(40)), 1e3);
}

TEST(Acceptance, AnEffectNeedsMoreThanAnotherStepRuleWouldPretend) {
  Acceptance acceptance;
  acceptance.Note(StepRuleOf("actuator_delay", 0, 50), {"a", "b"});
  const Candidate none = Model({});
  const double chance = acceptance.Needed(none, 0, Left(1e4));
  const double delay = acceptance.Needed(none, 0, Left(1e4), Model({MakeSpec("actuator_delay", {"a"})}));
  EXPECT_NEAR(delay, 0.5 * std::pow(std::sqrt(2 * chance) + 10, 2), 1e-9);
  // The largest of all screens is kept.
  acceptance.Note(StepRuleOf("actuator_delay", 0, 2), {"a", "b"});
  EXPECT_DOUBLE_EQ(delay, acceptance.Needed(none, 0, Left(1e4), Model({MakeSpec("actuator_delay", {"a"})})));
  // Joints that were not screened: the most of that effect.
  EXPECT_DOUBLE_EQ(delay, acceptance.Needed(none, 0, Left(1e4), Model({MakeSpec("actuator_delay", {"b"})})));
}

TEST(Acceptance, FreeBaseParametersNeedMoreThanAnotherStepRuleWouldPretend) {
  // Noise so fine that steps of 0.2 ms show.
  const auto p = testing::Prepare("pendulum", {}, 1, {.rate_hz = 500, .finer = 100});
  Candidate freed = Model({}, true);
  freed.plant = std::make_shared<const sim::Plant>(p->nominal);
  freed.parameters = FreeParameters(p->nominal, p->scales, true);
  freed.fit = Fit(p->data, FitModel{p->nominal, p->nominal.parameters().Nominal(), freed.parameters}, {});
  ASSERT_TRUE(freed.fit.ok);
  Acceptance acceptance;
  acceptance.NoteBase(p->data, freed, {});
  EXPECT_GT(acceptance.Needed(Model({}), 0, Left(1e4), freed), 100);
  // What acts beside parameters that are free already owes nothing to them.
  EXPECT_LT(acceptance.Needed(Model({}, true), 0, Left(1e4), freed), 10);
  // Nor is an effect on the parameters as given held to what they gain from it, beyond what it does itself.
  const Candidate offset = Model({MakeSpec("encoder_offset", {"a"})});
  const double alone = acceptance.Needed(Model({}, true), 0, Left(1e4), offset);
  EXPECT_LT(alone, -50);
  acceptance.Note(StepRuleOf("encoder_offset", 0, 20), {"a"});
  EXPECT_NEAR(acceptance.Needed(Model({}, true), 0, Left(1e4), offset), alone + 20, 1e-9);
  acceptance.Note(StepRuleOf("encoder_offset", 0, 1e9), {"a"});
  EXPECT_DOUBLE_EQ(acceptance.Needed(Model({}, true), 0, Left(1e4), offset), 3);
}

TEST(Acceptance, FewerFreeParametersNeedTheOddsOnly) {
  EXPECT_DOUBLE_EQ(
      Acceptance().Needed(Model({}, true), 0, Left(1e4), Model({MakeSpec("coulomb_friction", {"a"})})), 3);
  // Nor do the same kinds of effects, on more joints too, and without the free parameters.
  const Candidate freed = Model({MakeSpec("coulomb_friction", {"a"}), MakeSpec("actuator_lag", {"a"})}, true);
  const Candidate same = Model({MakeSpec("coulomb_friction", {"a"}), MakeSpec("coulomb_friction", {"b"})});
  EXPECT_DOUBLE_EQ(Acceptance().Needed(freed, 1e6, Left(1e4), same), 3);
  const Candidate other = Model({MakeSpec("coulomb_friction", {"a"}), MakeSpec("torque_offset", {"a"})});
  EXPECT_GT(Acceptance().Needed(freed, 1e6, Left(1e4), other), 1000) << "a force in the place of masses";
  const Candidate one = Model({MakeSpec("torque_offset", {"a"})}, true);
  const Candidate two = Model({MakeSpec("torque_offset", {"a"}), MakeSpec("torque_offset", {"b"})});
  EXPECT_GT(Acceptance().Needed(one, 1e6, Left(1e4), two), 1000) << "so is the same force on another joint";
}

}  // namespace
}  // namespace rg::diagnosis
