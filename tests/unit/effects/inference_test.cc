// What recordings tell of an effect, as the effects declare it.
#include "common/effects/inference.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "common/effects/effect_catalog.h"

namespace rg::effects {
namespace {

std::vector<std::string> JointsFor(const EffectInfo& effect) {
  if (effect.scope == Scope::kJointPair) return {"a", "b"};
  return effect.scope == Scope::kRobot ? std::vector<std::string>{} : std::vector<std::string>{"a"};
}

Status ValidStart(const EffectInfo& effect, const Start& start) {
  EffectSpec spec = MakeSpec(effect.id, JointsFor(effect), start.values);
  spec.options = start.options;
  return ValidateSpec(spec);
}

TEST(Inference, TermsNameParametersOfTheirEffect) {
  for (const EffectInfo& effect : Catalog()) {
    const Inference& own = InferenceOf(effect.id);
    if (!own.shape.empty()) {
      EXPECT_GE(effect.FindParameter(own.shape), 0) << effect.id;
    }
    if (!own.stays.empty()) {
      EXPECT_GE(effect.FindParameter(own.stays), 0) << effect.id;
    }
    if (!own.rotor.empty()) {
      EXPECT_GE(effect.FindParameter(own.rotor), 0) << effect.id;
    }
    for (const Term& t : own.terms) {
      for (const std::string& name : t.adds_to) EXPECT_GE(effect.FindParameter(name), 0) << effect.id;
    }
  }
}

TEST(Inference, EachLawIsThePlainestEffectThatHasIt) {
  for (const EffectInfo& effect : Catalog()) {
    for (const Term& t : InferenceOf(effect.id).terms) {
      const auto& terms = InferenceOf(LawOf(t.regressor).id).terms;
      EXPECT_LE(terms.size(), InferenceOf(effect.id).terms.size()) << effect.id;
      EXPECT_TRUE(std::any_of(terms.begin(), terms.end(), [&](const Term& other) {
        return other.regressor == t.regressor;
      })) << effect.id;
    }
  }
  EXPECT_EQ(LawOf(Regressor::kDirection).id, "coulomb_friction") << "of all that have its sign";
  EXPECT_EQ(LawOf(Regressor::kConstant).id, "torque_offset") << "a spring has a constant too";
}

TEST(Inference, CoefficientsMakeAValidStart) {
  const double link[] = {2.0, 0.1, 0, 0, 0, 0, 0, 0, 0, 0};
  for (const EffectInfo& effect : Catalog()) {
    const Inference& own = InferenceOf(effect.id);
    if (own.terms.empty() && own.starts == nullptr) continue;
    const std::vector<double> c(std::max<size_t>(4, own.terms.size()), 0.3);
    Found found{c, 0.5, 0.8};
    found.last_link = link;
    for (const Start& start : StartsOf(effect, found))
      EXPECT_TRUE(ValidStart(effect, start).ok()) << ValidStart(effect, start).ToString();
  }
}

TEST(Inference, WhatMustBePositiveStartsFromAPartOfWhatIsUsual) {
  const std::vector<double> none = {-1.0, -1.0};
  Found found{none, 0.5};
  found.joint.torque = 10;
  const Values stribeck = StartsOf(LawOf(Regressor::kSlowly), found)[0].values;
  EXPECT_DOUBLE_EQ(stribeck.at("coulomb"), 0.2);
  EXPECT_DOUBLE_EQ(stribeck.at("static"), 0.2);
  EXPECT_DOUBLE_EQ(stribeck.at("stribeck_velocity"), 0.5);
  EXPECT_DOUBLE_EQ(StartsOf(LawOf(Regressor::kConstant), found)[0].values.at("offset"), -1.0);
}

TEST(Inference, StartsWithoutAScreenAreValid) {
  const double link[] = {2.0, 0.1, 0, 0, 0, 0, 0, 0, 0, 0};
  Blind blind;
  blind.rotors = {0.1, 0.4};
  blind.last_link = link;
  int with = 0;
  for (const EffectInfo& effect : Catalog()) {
    const Inference& own = InferenceOf(effect.id);
    if (own.blind == nullptr) continue;
    ++with;
    EXPECT_FALSE(own.blind(blind).empty());
    for (const Start& start : own.blind(blind)) EXPECT_TRUE(ValidStart(effect, start).ok()) << effect.id;
  }
  EXPECT_EQ(with, 5) << "two gears, two loads, a mount";
}

TEST(Inference, WhatIsOfAStrengthIsValidAndShortOfNothing) {
  JointSize joint;
  for (const EffectInfo& effect : Catalog()) {
    const auto of = InferenceOf(effect.id).of_strength;
    if (of != nullptr) {
      EXPECT_TRUE(ValidStart(effect, {of(0.4, 0.02, joint), {}}).ok()) << effect.id;
    }
  }
  for (const std::string& id : EffectsIn(Slot::kDryFriction))
    EXPECT_NE(InferenceOf(id).of_strength, nullptr) << id << " can stand in another's place";
}

TEST(Inference, EveryParameterHasABelief) {
  for (const EffectInfo& effect : Catalog()) {
    const EffectSpec spec = MakeSpec(effect.id, JointsFor(effect), {});
    for (const ParameterInfo& p : effect.parameters) {
      const Prior prior = PriorOf(spec, p, 0.7, {});
      EXPECT_TRUE(std::isfinite(prior.center) && prior.stddev > 0) << effect.id << " " << p.name;
      EXPECT_LT(prior.lower, prior.upper) << effect.id << " " << p.name;
    }
  }
}

TEST(Inference, WhatIsNoEffectHasNone) {
  EXPECT_TRUE(InferenceOf("parameters_only").terms.empty());
  EXPECT_FALSE(IsIn(Slot::kDelay, "parameters_only"));
}

}  // namespace
}  // namespace rg::effects
