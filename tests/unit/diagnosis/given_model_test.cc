// A diagnosis that starts from a model says what that model lacks, and nothing that it has.
#include "services/diagnosis/hypotheses/given_model.h"

#include <gtest/gtest.h>

#include "common/base/clock.h"
#include "services/diagnosis/data/prepare_data.h"
#include "services/diagnosis/diagnosis.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/sysid/sysid_on_set.h"
#include "tests/unit/diagnosis/simulated_set.h"

namespace rg::diagnosis {
namespace {

using effects::MakeSpec;

sim::ModelFile WithFriction(const recordings::RecordingSet& set) {
  const sim::Plant urdf = sysid::NominalPlant(set).value();
  sim::Plant plant =
      sim::Plant::Create(urdf.shared_model(), urdf.options(),
                         {MakeSpec("coulomb_friction", {"shoulder", "elbow"}, {{"coulomb", 0.1}})})
          .value();
  Eigen::VectorXd values = plant.parameters().Nominal();
  values[plant.parameters().Find("coulomb_friction.elbow.coulomb")] = 0.6;
  values[plant.parameters().Find("mass.forearm")] *= 1.1;
  values[plant.parameters().Find("force_gain.elbow")] = 0.9;
  return {plant, values, 3};
}

TEST(GivenModel, IsNominalWithTheValuesThatItHas) {
  const auto set = testing::MakeSet("arm2", {}, 9, 1.0);
  const sim::ModelFile model = WithFriction(set);
  const sim::Plant given = GivenPlant(set, model).value();
  EXPECT_EQ(given.parameters().Nominal(), model.values);
  const auto specs = GivenEffects(given);
  ASSERT_EQ(specs.size(), 2u);
  EXPECT_EQ(specs[1].joints, std::vector<std::string>{"elbow"});
  EXPECT_EQ(specs[1].values.at("elbow").at("coulomb"), 0.6);
  EXPECT_TRUE(Beyond(given, specs).empty());
  EXPECT_EQ(Beyond(given, {MakeSpec("viscous_friction", {"elbow"})}).size(), 1u);
  EXPECT_TRUE(GivenEffects(GivenPlant(set, {}).value()).empty());
  auto other = set;
  other.joints = {"shoulder"};
  EXPECT_FALSE(GivenPlant(other, model).ok());
}

// A prior about zero would pull a large friction of a joint that it holds still, and the whole fit with it.
TEST(GivenModel, WhatItStatesIsTheCentreOfItsPrior) {
  const auto set = testing::MakeSet("arm2", {}, 9, 1.0);
  const sim::Plant given = GivenPlant(set, WithFriction(set)).value();
  const auto data = PrepareData(set, given, {});
  ASSERT_TRUE(data.ok());
  const MotionScales scales = ScalesOf(*data, given);
  const auto prior_of = [&](const sim::Plant* stated) {
    for (const sysid::FitParameter& p : FreeParameters(given, scales, false, stated)) {
      if (p.name == "coulomb_friction.elbow.coulomb") return p;
    }
    return sysid::FitParameter{};
  };
  EXPECT_EQ(prior_of(nullptr).nominal, 0.0);
  EXPECT_EQ(prior_of(&given).nominal, 0.6);
  EXPECT_GE(prior_of(&given).prior_stddev, 0.3);
}

TEST(GivenModel, WhatItHasIsNoFindingAndWhatItLacksIs) {
  const auto set = testing::MakeSet("arm2",
                                    {MakeSpec("coulomb_friction", {"elbow"}, {{"coulomb", 0.6}}),
                                     MakeSpec("viscous_friction", {"shoulder"}, {{"viscous", 0.8}})},
                                    9, 2.0);
  const sim::Plant urdf = sysid::NominalPlant(set).value();
  const auto diagnose = [&](const std::vector<effects::EffectSpec>& specs) {
    const sim::Plant plant = sim::Plant::Create(urdf.shared_model(), urdf.options(), specs).value();
    DiagnosisOptions options;
    options.threads = 1;
    options.model = sim::ModelFile{plant, plant.parameters().Nominal(), 0};
    return Diagnose(set, options, RealClock()).value();
  };
  const auto half = diagnose({MakeSpec("coulomb_friction", {"elbow"}, {{"coulomb", 0.5}})});
  ASSERT_FALSE(half.findings.empty());
  EXPECT_EQ(half.findings[0].effect, "viscous_friction");
  for (const Finding& f : half.findings) EXPECT_NE(f.effect, "coulomb_friction");
  const int at = half.plant->parameters().Find("coulomb_friction.elbow.coulomb");
  ASSERT_GE(at, 0) << "it stays";
  EXPECT_NEAR(half.values[at], 0.6, 0.03);
  const auto whole = diagnose({MakeSpec("coulomb_friction", {"elbow"}, {{"coulomb", 0.6}}),
                               MakeSpec("viscous_friction", {"shoulder"}, {{"viscous", 0.8}})});
  EXPECT_EQ(whole.verdict, "no_mismatch");
}

// Its friction drops with speed; drag that it lacks bends it the other way until that is found.
TEST(GivenModel, WhatItHasIsNotDoubtedWhileSomethingIsMissing) {
  const std::string pivot = sysid::testing::LoadPlant("pendulum").joint_names()[0];
  const effects::EffectSpec friction = MakeSpec(
      "stribeck_friction", {pivot}, {{"coulomb", 0.10}, {"static", 0.25}, {"stribeck_velocity", 0.3}});
  const auto set = testing::MakeSet(
      "pendulum", {friction, MakeSpec("quadratic_drag", {pivot}, {{"quadratic", 0.2}})}, 10, 2.0);
  const sim::Plant urdf = sysid::NominalPlant(set).value();
  const sim::Plant plant = sim::Plant::Create(urdf.shared_model(), urdf.options(), {friction}).value();
  DiagnosisOptions options;
  options.threads = 1;
  options.model = sim::ModelFile{plant, plant.parameters().Nominal(), 0};
  const auto result = Diagnose(set, options, RealClock()).value();
  EXPECT_EQ(result.verdict, "unmodelled_physics");
  ASSERT_FALSE(result.findings.empty());
  EXPECT_EQ(result.findings[0].effect, "quadratic_drag");
}

}  // namespace
}  // namespace rg::diagnosis
