// One rule per need of the catalogue: a survey that has everything, and one that lacks a single thing.
#include "services/diagnosis/reporting/what_shows.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "common/effects/effect_catalog.h"
#include "services/sysid/sysid_on_set.h"
#include "tests/unit/diagnosis/simulated_set.h"

namespace rg::diagnosis {
namespace {

using effects::Need;
using ::testing::HasSubstr;

struct Surveyed {
  sim::Plant plant;
  MotionSurvey survey;
};

Surveyed SurveyedWithPlant(const recordings::RecordingSet& set) {
  const auto plant = sysid::NominalPlant(set);
  RG_CHECK(plant.ok()) << plant.status().ToString();
  auto survey = Survey(set, *plant);
  RG_CHECK(survey.ok()) << survey.status().ToString();
  return {*plant, *std::move(survey)};
}

// Two joints that do all that any effect asks for.
const Surveyed& Rich() {
  static const Surveyed& rich = *new Surveyed(SurveyedWithPlant(testing::MakeSet("arm2", {}, 61)));
  return rich;
}

const EffectShows& Of(const std::vector<EffectShows>& all, const std::string& id) {
  return *std::find_if(all.begin(), all.end(), [&](const EffectShows& e) { return e.effect == id; });
}

std::string WhyNotOn(const EffectShows& effect, const std::string& joint) {
  for (const WhyNot& w : effect.not_on) {
    if (std::find(w.joints.begin(), w.joints.end(), joint) != w.joints.end()) return w.reason;
  }
  return "";
}

// With the survey changed, every effect with the need is refused on the joints given, for that reason, and
// effects that can show without it still do. A short travel holds no periods of a ripple either.
void ExpectLost(Need need, const MotionSurvey& survey, const std::vector<int>& joints,
                const std::string& reason) {
  const auto before = WhatShows(Rich().survey, Rich().plant), after = WhatShows(survey, Rich().plant);
  int with = 0;
  for (const EffectShows& e : after) {
    const auto& needs = effects::FindEffect(e.effect)->needs;
    if (need == Need::kTravel && std::ranges::count(needs, Need::kPeriods) > 0) {
      EXPECT_FALSE(e.shows) << e.effect;
      continue;
    }
    if (std::find(needs.begin(), needs.end(), need) == needs.end()) {
      EXPECT_EQ(e.shows, Of(before, e.effect).shows) << e.effect;
      continue;
    }
    ++with;
    for (const int j : joints)
      EXPECT_THAT(WhyNotOn(e, Rich().plant.joint_names()[static_cast<size_t>(j)]), HasSubstr(reason))
          << e.effect;
  }
  EXPECT_GT(with, 0) << effects::NeedName(need);
}

TEST(WhatShows, ARichMotionShowsEveryEffectThatFindingsName) {
  const auto all = WhatShows(Rich().survey, Rich().plant);
  EXPECT_EQ(all.size(), effects::Catalog().size() - 1)
      << "a force over two joints is told as one over a joint";
  for (const EffectShows& e : all) EXPECT_TRUE(e.shows) << e.effect << " " << InWords(e, 2)[3];
}

TEST(WhatShows, MotionOneWayShowsNoDryFriction) {
  MotionSurvey s = Rich().survey;
  for (JointFigures& f : s.joints) f.up += f.down, f.down = 0;
  ExpectLost(Need::kBothWays, s, {0, 1}, "one way only");
}

TEST(WhatShows, OneSpeedTellsViscousFrictionFromNothing) {
  MotionSurvey s = Rich().survey;
  for (JointFigures& f : s.joints) f.slow = 0.9 * f.fast;
  const auto all = WhatShows(s, Rich().plant);
  for (const char* id : {"viscous_friction", "quadratic_drag"}) EXPECT_FALSE(Of(all, id).shows) << id;
  EXPECT_TRUE(Of(all, "coulomb_friction").shows);
}

TEST(WhatShows, StribeckFrictionWantsSlowRows) {
  MotionSurvey s = Rich().survey;
  for (JointFigures& f : s.joints) f.slow_rows = 2;
  ExpectLost(Need::kSlowMotion, s, {0, 1}, "2 rows");
}

TEST(WhatShows, RareRowsShowNoVibrationsAndRarerOnesNoReversals) {
  MotionSurvey s = Rich().survey;
  for (FileFigures& f : s.files) f.period = 0.04;
  ExpectLost(Need::kResonances, s, {0, 1}, "too rare for vibrations");
  for (FileFigures& f : s.files) f.period = 0.1;
  const auto all = WhatShows(s, Rich().plant);
  for (const char* id : {"stribeck_friction", "actuator_delay", "sensor_delay", "joint_elasticity"})
    EXPECT_FALSE(Of(all, id).shows) << id;
  EXPECT_TRUE(Of(all, "viscous_friction").shows);
}

TEST(WhatShows, InertiaWantsAccelerationsBeyondNoise) {
  MotionSurvey s = Rich().survey;
  for (JointFigures& f : s.joints) f.acceleration = f.acceleration_noise;
  const auto all = WhatShows(s, Rich().plant);
  EXPECT_FALSE(Of(all, "rotor_inertia").shows);
  EXPECT_FALSE(Of(all, "base_flexibility").shows);
}

TEST(WhatShows, ASmallTravelShowsNothingOfPosition) {
  MotionSurvey s = Rich().survey;
  for (JointFigures& f : s.joints) f.high = f.low + 0.02;
  ExpectLost(Need::kTravel, s, {0, 1}, "travels by 0.02 rad only");
}

TEST(WhatShows, OneJointIsJudgedByItself) {
  MotionSurvey s = Rich().survey;
  s.joints[0].up += s.joints[0].down, s.joints[0].down = 0;
  const auto all = WhatShows(s, Rich().plant);
  EXPECT_THAT(Of(all, "coulomb_friction").joints, ::testing::ElementsAre("elbow"));
  EXPECT_THAT(WhyNotOn(Of(all, "coulomb_friction"), "shoulder"), HasSubstr("one way"));
}

TEST(WhatShows, AnEffortOfOneSignShowsNoDeadBand) {
  MotionSurvey s = Rich().survey;
  for (JointFigures& f : s.joints) f.effort_least = 0.1 * f.peak_effort;
  const auto all = WhatShows(s, Rich().plant);
  EXPECT_FALSE(Of(all, "torque_deadband").shows);
  EXPECT_FALSE(Of(all, "backlash").shows);
  EXPECT_TRUE(Of(all, "torque_gain").shows);
}

TEST(WhatShows, WarmingWantsATemperatureThatChangesWhereOneIsRecorded) {
  MotionSurvey s = Rich().survey;
  for (JointFigures& f : s.joints) f.temperature_low = 30, f.temperature_high = 30.2;
  ExpectLost(Need::kWarming, s, {0, 1}, "by 0.2 K only");
  for (JointFigures& f : s.joints) f.temperature_high = 34;
  EXPECT_TRUE(Of(WhatShows(s, Rich().plant), "thermal_drift").shows);
}

TEST(WhatShows, NothingShowsOnAJointThatNeverMovedOrMovesAsMeasured) {
  MotionSurvey s = Rich().survey;
  s.joints[0].moved = false;
  for (const EffectShows& e : WhatShows(s, Rich().plant)) {
    EXPECT_EQ(std::count(e.joints.begin(), e.joints.end(), "shoulder"), 0) << e.effect;
  }
  s = Rich().survey;
  s.joints[1].prescribed = true;
  for (const EffectShows& e : WhatShows(s, Rich().plant)) {
    EXPECT_EQ(std::count(e.joints.begin(), e.joints.end(), "elbow"), 0) << e.effect;
  }
}

TEST(WhatShows, WhatBelongsToADriveWantsOne) {
  MotionSurvey s = Rich().survey;
  s.joints[1].peak_effort = 0;
  for (const EffectShows& e : WhatShows(s, Rich().plant)) {
    const effects::EffectInfo& info = *effects::FindEffect(e.effect);
    if (info.scope == effects::Scope::kJoint && info.NeedsDrive()) {
      EXPECT_EQ(std::count(e.joints.begin(), e.joints.end(), "elbow"), 0) << e.effect;
    }
  }
}

TEST(WhatShows, NoGravityShowsNoTilt) {
  // The axes of this arm are along y.
  auto set = testing::MakeSet("arm2", {}, 62);
  set.gravity = {0, 0, 0};
  const Surveyed at = SurveyedWithPlant(set);
  EXPECT_FALSE(Of(WhatShows(at.survey, at.plant), "gravity_misalignment").shows);
  EXPECT_TRUE(Of(WhatShows(Rich().survey, Rich().plant), "gravity_misalignment").shows);
}

TEST(InWords, ListsAllJointsAsSuch) {
  const EffectShows shows{"x", true, {"a", "b"}, "within", {}};
  EXPECT_EQ(InWords(shows, 2), (std::vector<std::string>{"x", "all joints", "within", ""}));
  const EffectShows part{"x", true, {"a"}, "", {{{"b"}, "never moved"}}};
  EXPECT_EQ(InWords(part, 2), (std::vector<std::string>{"x", "a", "", "b: never moved"}));
}

}  // namespace
}  // namespace rg::diagnosis
