// Names beside a force without one.
#include "services/diagnosis/search/unnamed_forces.h"

#include <gtest/gtest.h>

#include "common/base/clock.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "tests/unit/diagnosis/prepared_set.h"

namespace rg::diagnosis {
namespace {

using effects::EffectSpec;
using effects::MakeSpec;

constexpr char kPivot[] = "hinge";

// A pendulum with a force over its position that no law of the catalogue has, and more.
struct World {
  explicit World(std::vector<EffectSpec> more, bool nameless = true) {
    EffectSpec bump =
        MakeSpec("unknown_field", {kPivot}, {{"low", -1.5}, {"high", 1.5}, {"w3", 0.4}, {"w4", 0.5}});
    bump.options["variable"] = "position";
    if (nameless) more.push_back(bump);
    p = testing::Prepare("pendulum", std::move(more), 61);
    setting = std::make_unique<FitSetting>(FitSetting{p->data, p->nominal, p->scales});
    ledger = std::make_unique<FitLedger>(*setting, p->options, 1, trace, nullptr);
    ledger->Evaluate({}, false);
    forces = std::make_unique<UnnamedForces>(
        *setting, *ledger, given,
        [this](const Candidate& c) {
          const FitModel model{*c.plant, c.fit.values, {}};
          return EstimateMissingForce(p->data, model, InitialStates(p->data, model, {}), p->scales.torque,
                                      0.05, {});
        },
        [](const Candidate&, const Candidate&) { return 5.0; },
        [this](const Candidate& from, Candidate* best) {
          for (const EffectSpec& beside : pool) {
            const Candidate c = ledger->Evaluate(Joined(Refreshed(from), {beside}), false, &from);
            if (c.score > best->score) *best = c;
          }
        });
    forces->Try(false, {"position"}, [](const Candidate&) { return false; });
  }

  std::unique_ptr<testing::Prepared> p;
  std::unique_ptr<FitSetting> setting;
  FakeClock clock;
  Trace trace{clock};
  std::vector<EffectSpec> given;
  std::vector<EffectSpec> pool = {MakeSpec("sensor_delay", {kPivot}, {{"delay", 0.005}}),
                                  MakeSpec("viscous_friction", {kPivot}, {{"viscous", 0.02}})};
  std::unique_ptr<FitLedger> ledger;
  std::unique_ptr<UnnamedForces> forces;
};

TEST(UnnamedForces, HaveTheNamesBesideThemThatExplainTheRest) {
  World w({MakeSpec("sensor_delay", {kPivot}, {{"delay", 0.02}})});
  const Candidate* unnamed = w.forces->Best();
  ASSERT_NE(unnamed, nullptr);
  ASSERT_GT(w.ledger->PerRow(*unnamed), 2.0);
  const Candidate named = w.forces->WithNames(Candidate(*unnamed));
  EXPECT_TRUE(HasUnnamed(named));
  EXPECT_TRUE(HasKind(named.specs, "sensor_delay"));
  EXPECT_FALSE(HasKind(named.specs, "viscous_friction"));
  EXPECT_LT(w.ledger->PerRow(named), kExplained);
  EXPECT_NEAR(named.fit.values[named.plant->parameters().Find("sensor_delay.hinge.delay")], 0.02, 0.001);
}

// A name that takes some of what a coarse surface leaves is no effect.
TEST(UnnamedForces, HaveNoNameBesideThemThatLeavesMostOfTheRest) {
  World w({MakeSpec("sensor_delay", {kPivot}, {{"delay", 0.02}})});
  w.pool.erase(w.pool.begin());
  const Candidate unnamed = *w.forces->Best();
  EXPECT_EQ(KeyOf(w.forces->WithNames(unnamed).specs), KeyOf(unnamed.specs));
}

TEST(UnnamedForces, KeepOnlyNamesThatHalveWhatIsLeftWithoutThem) {
  World w({MakeSpec("sensor_delay", {kPivot}, {{"delay", 0.02}})});
  const Candidate unnamed = *w.forces->Best();
  const Candidate both = w.ledger->Evaluate(Joined(Refreshed(unnamed), w.pool), false, &unnamed);
  const Candidate kept = w.forces->WithoutCoarse(both);
  EXPECT_TRUE(HasKind(kept.specs, "sensor_delay"));
  EXPECT_FALSE(HasKind(kept.specs, "viscous_friction"));
}

TEST(UnnamedForces, GoWhereNamesDoAsWellWithoutThem) {
  World w({MakeSpec("sensor_delay", {kPivot}, {{"delay", 0.02}})}, false);
  const Candidate unnamed = *w.forces->Best();
  ASSERT_TRUE(HasUnnamed(unnamed));
  ASSERT_GT(w.ledger->PerRow(unnamed), 2.0);
  const Candidate kept = w.forces->WithNames(unnamed);
  EXPECT_FALSE(HasUnnamed(kept));
  EXPECT_TRUE(HasKind(kept.specs, "sensor_delay"));
}

}  // namespace
}  // namespace rg::diagnosis
