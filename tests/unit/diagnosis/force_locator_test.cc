// Where a force is missing, whatever its form, and names beside it.
#include "services/diagnosis/search/force_locator.h"

#include <gtest/gtest.h>

#include "common/base/clock.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "tests/unit/diagnosis/prepared_set.h"

namespace rg::diagnosis {
namespace {

using effects::EffectSpec;
using effects::MakeSpec;

const char kShoulder[] = "shoulder", kElbow[] = "elbow";

// A saddle over two joints' positions and a force over speed at once: no grid of weights follows both.
std::vector<EffectSpec> With(std::vector<EffectSpec> more) {
  more.push_back(MakeSpec("unknown_field_pair", {kElbow, kShoulder},
                          {{"low", -1.5},
                           {"high", 1.5},
                           {"other_low", -1.5},
                           {"other_high", 1.5},
                           {"w22", 0.9},
                           {"w33", 0.9},
                           {"w23", -0.9},
                           {"w32", -0.9}}));
  EffectSpec speed =
      MakeSpec("unknown_field", {kShoulder}, {{"low", -3.0}, {"high", 3.0}, {"w3", 0.2}, {"w4", -0.3}});
  speed.options["variable"] = "velocity";
  more.push_back(speed);
  return more;
}
EffectSpec Field() {
  EffectSpec out = MakeSpec("unknown_field", {kShoulder}, {{"low", -2.0}, {"high", 2.0}});
  out.options["variable"] = "position";
  return out;
}
const EffectSpec kOffset = MakeSpec("torque_offset", {kElbow}, {{"offset", 0.25}});

// A search that has compared base parameters as given and free, and nothing else.
struct Searched {
  explicit Searched(std::vector<EffectSpec> effects)
      : p(testing::Prepare("arm2", std::move(effects), 67)),
        state({p->data, p->nominal, p->scales}, p->options, 2, clock, progress, nullptr) {
    step.MakeFeatures();
    for (const bool base : {false, true}) state.fits.Evaluate({}, base);
  }
  const Candidate& Without() const { return *state.fits.Known({}, false); }
  double Value(const Candidate& c, const std::string& name) const {
    return c.fit.values[c.plant->parameters().Find(name)];
  }

  std::unique_ptr<testing::Prepared> p;
  FakeClock clock;
  ProgressFn progress;
  SearchState state;
  ForwardStep step{state};
  ForceLocator locator{state, step};
};

TEST(ForceLocator, FindsTheJointOfAForceThatNoGridFollows) {
  Searched w(With({kOffset}));
  EXPECT_EQ(w.locator.Where(w.Without()), std::set<int>{0});
}

// Far from the recordings the linearisation leaves something of a strong force, but far less than elsewhere.
TEST(ForceLocator, FindsTheJointOfAForceThatStandsOut) {
  std::vector<EffectSpec> strong = With({});
  for (EffectSpec& s : strong) {
    for (auto& [owner, values] : s.values) {
      for (auto& [name, value] : values) {
        if (name[0] == 'w') value *= 8;
      }
    }
  }
  Searched w(strong);
  ASSERT_GT(w.state.fits.PerRow(w.Without()), 100.0);
  EXPECT_EQ(w.locator.Where(w.Without()), std::set<int>{0});
}

TEST(ForceLocator, KnowsNoJointWhereNothingIsMissing) {
  Searched nothing({});
  EXPECT_TRUE(nothing.locator.Where(nothing.Without()).empty());
}

TEST(ForceLocator, KnowsNoJointWhereTheWholeRobotIsMoved) {
  Searched w({MakeSpec("payload", {}, {{"mass", 0.5}, {"com_x", 0.1}, {"com_y", 0.2}, {"com_z", 0.0}})});
  EXPECT_TRUE(w.locator.Where(w.Without()).empty());
}

TEST(ForceLocator, ExplainsByALawOnThatJointBesideWhatIsNamed) {
  Searched w({MakeSpec("stribeck_friction", {kShoulder},
                       {{"coulomb", 0.1}, {"static", 0.2}, {"stribeck_velocity", 0.3}}),
              MakeSpec("torque_offset", {kElbow}, {{"offset", 0.05}})});
  Candidate winner = w.Without();
  ASSERT_TRUE(w.locator.Explain(w.Without(), &winner));
  EXPECT_EQ(KeyOf(winner.specs), "stribeck_friction[shoulder ] torque_offset[elbow ] ");
  EXPECT_LT(w.state.fits.PerRow(winner), kExplained);
  EXPECT_FALSE(w.state.HasForceInPlace(winner));
}

TEST(ForceLocator, ExplainsByAnUnnamedForceWhereNoLawDoes) {
  Searched w(With({kOffset}));
  Candidate winner = w.Without();
  ASSERT_TRUE(w.locator.Explain(w.Without(), &winner));
  EXPECT_TRUE(w.state.HasForceInPlace(winner));
  EXPECT_EQ(w.state.place, 0);
  EXPECT_TRUE(Contains(winner.specs, "torque_offset", kElbow));
  Candidate named = winner;
  EXPECT_TRUE(w.locator.NameBeside(&named)) << "it has its names already";
  EXPECT_EQ(KeyOf(named.specs), KeyOf(winner.specs));
}

TEST(ForceLocator, ExplainsByNameNeitherAForceWithoutOneNorWhatMovesTheWholeRobot) {
  Searched force(With({}));
  Candidate winner = force.Without();
  EXPECT_FALSE(force.locator.ExplainByName(force.Without(), &winner));
  EXPECT_GT(force.state.fits.tried().size(), 2u) << "what acts on its joint was tried";
  Searched payload(
      {MakeSpec("payload", {}, {{"mass", 0.5}, {"com_x", 0.1}, {"com_y", 0.2}, {"com_z", 0.0}})});
  EXPECT_FALSE(payload.locator.ExplainByName(payload.Without(), &winner));
  EXPECT_EQ(payload.state.fits.tried().size(), 2u) << "nothing was tried";
}

// Play is no column of a screen, but any force on its joint explains what it does.
TEST(ForceLocator, NamesPlayOfTheJointOnWhichAForceIsMissing) {
  Searched w({MakeSpec("backlash", {kElbow},
                       {{"gap", 0.06},
                        {"contact_stiffness", 2000.0},
                        {"contact_damping", 3.0},
                        {"motor_inertia", 0.05},
                        {"motor_viscous", 0.0}})});
  Candidate winner = w.Without();
  ASSERT_TRUE(w.locator.ExplainByName(w.Without(), &winner));
  EXPECT_TRUE(Contains(winner.specs, "backlash", kElbow)) << KeyOf(winner.specs);
  EXPECT_EQ(winner.specs.size(), 1u);
}

TEST(ForceLocator, ExplainsNothingWhereNothingIsMissing) {
  Searched nothing({});
  Candidate winner = nothing.Without();
  EXPECT_FALSE(nothing.locator.Explain(nothing.Without(), &winner));
  EXPECT_EQ(KeyOf(winner.specs), "");
}

// What the model was given with is no new force, though it has no name.
TEST(ForceLocator, ExplainsBesideAnUnnamedForceThatWasGiven) {
  EffectSpec bump = Field();
  bump.values[kShoulder]["w3"] = 0.4, bump.values[kShoulder]["w4"] = 0.5;
  Searched w({bump, MakeSpec("viscous_friction", {kElbow}, {{"viscous", 0.1}})});
  w.state.given = {bump};
  for (const bool base : {false, true}) w.state.fits.Evaluate({bump}, base);
  const Candidate around = *w.state.fits.Known({bump}, false);
  EXPECT_FALSE(w.state.HasNewForce(around));
  Candidate winner = around;
  ASSERT_TRUE(w.locator.Explain(around, &winner));
  EXPECT_TRUE(Contains(winner.specs, "viscous_friction", kElbow)) << KeyOf(winner.specs);
  EXPECT_FALSE(w.state.HasForceInPlace(winner));
}

TEST(ForceLocator, NamesEffectsOfOtherJointsWithTheirValues) {
  Searched w(With({kOffset}));
  Candidate best = w.state.fits.Evaluate({Field()}, false);
  ASSERT_GT(w.state.fits.PerRow(best), 5.0);
  ASSERT_TRUE(w.locator.NameBeside(&best));
  EXPECT_TRUE(HasUnnamed(best));
  EXPECT_TRUE(Contains(best.specs, "torque_offset", kElbow));
  EXPECT_EQ(FreshKinds(Candidate{}, best).size(), 2) << KeyOf(best.specs);
  EXPECT_NEAR(w.Value(best, "torque_offset.elbow.offset"), 0.25, 0.03);
}

TEST(ForceLocator, NamesNothingWhereTheForceIsAll) {
  Searched w(With({}));
  Candidate best = w.state.fits.Evaluate({Field()}, false);
  const std::string before = KeyOf(best.specs);
  EXPECT_FALSE(w.locator.NameBeside(&best));
  EXPECT_EQ(KeyOf(best.specs), before);
}

TEST(ForceLocator, NamesEffectsWhereNothingWasFound) {
  Searched w(With({kOffset}));
  Candidate best = w.state.fits.Evaluate({}, true);
  ASSERT_TRUE(w.locator.NameBeside(&best));
  EXPECT_TRUE(HasUnnamed(best));
  EXPECT_TRUE(Contains(best.specs, "torque_offset", kElbow));
}

TEST(ForceLocator, LeavesConsistentModelsAlone) {
  Searched nothing({});
  Candidate best = nothing.state.fits.Evaluate({}, false);
  ASSERT_LT(nothing.state.fits.PerRow(best), kExplained);
  EXPECT_FALSE(nothing.locator.NameBeside(&best));
  EffectSpec bump = Field();
  bump.values[kShoulder]["w3"] = 0.4, bump.values[kShoulder]["w4"] = 0.5;
  Searched force({bump});
  best = force.state.fits.Evaluate({bump}, false);
  ASSERT_LT(force.state.fits.PerRow(best), kExplained);
  EXPECT_FALSE(force.locator.NameBeside(&best));
}

// A given effect is no finding, and none is told of its joint.
TEST(ForceLocator, NamesNothingThatTheModelHas) {
  Searched w(With({kOffset}));
  w.state.given = {MakeSpec("torque_offset", {kElbow}, {{"offset", 0.1}})};
  for (const bool base : {false, true}) w.state.fits.Evaluate(w.state.given, base);
  Candidate best = w.state.fits.Evaluate(Joined(w.state.given, {Field()}), false);
  w.locator.NameBeside(&best);
  EXPECT_LE(FreshKinds(Candidate{}, best).size(), 2) << KeyOf(best.specs);
}

}  // namespace
}  // namespace rg::diagnosis
