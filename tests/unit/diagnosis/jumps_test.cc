#include "services/diagnosis/likelihood/jumps.h"

#include <gtest/gtest.h>

#include <numeric>

#include "services/diagnosis/data/prepare_data.h"
#include "services/diagnosis/likelihood/followed_fit.h"
#include "services/diagnosis/likelihood/held_out.h"
#include "services/diagnosis/search/fit_requests.h"
#include "tests/unit/diagnosis/prepared_set.h"

namespace rg::diagnosis {
namespace {

using effects::EffectSpec;
using effects::MakeSpec;

struct Fits {
  double bare, free, counted;  // χ² per row: without a mass, with one that starts anew, as it counts
};

// A mass in springs, fitted to a pendulum with `truth`.
Fits MassOn(const std::vector<EffectSpec>& truth, uint64_t seed, double rate_hz = 100) {
  const auto p = testing::Prepare("pendulum", truth, seed, {.rate_hz = rate_hz});
  const FitSetting setting{p->data, p->nominal, p->scales};
  const std::vector<EffectSpec> mass = {
      MakeSpec("sloshing_payload", {}, {{"mass", 0.05}, {"stiffness", 5.0}, {"damping", 0.02}})};
  const Candidate c = Unfitted(setting, mass, false);
  const auto per_row = [](const FitResult& fit) {
    EXPECT_TRUE(fit.ok);
    EXPECT_NEAR(std::accumulate(fit.window_chi2.begin(), fit.window_chi2.end(), 0.0), fit.chi2,
                1e-9 * fit.chi2);
    return fit.chi2 / fit.rows;
  };
  const FitModel model{*c.plant, c.plant->parameters().Nominal(), c.parameters};
  return {per_row(MakeFit(setting, {{}, false, {}})), per_row(Fit(p->data, model, {})),
          per_row(MakeFit(setting, {mass, false, {}}))};
}

TEST(Jumps, AMassThatStartsAnewInEachWindowDoesNotCountForWhatItFollowsSo) {
  const std::string pivot = sysid::testing::LoadPlant("pendulum").joint_names()[0];
  for (const double rate_hz : {100.0, 1000.0}) {  // at 1 kHz nodes do not divide the rows of a window
    const Fits friction = MassOn({MakeSpec("coulomb_friction", {pivot}, {{"coulomb", 0.15}})}, 41, rate_hz);
    EXPECT_LT(friction.free - 1, 0.5 * (friction.bare - 1)) << rate_hz << " Hz";
    EXPECT_GT(friction.counted - 1, 2 * (friction.free - 1)) << rate_hz << " Hz";
  }
}

TEST(Jumps, ATrueMassGoesOnFromWindowToWindow) {
  const Fits swings =
      MassOn({MakeSpec("sloshing_payload", {}, {{"mass", 0.05}, {"stiffness", 5.0}, {"damping", 0.02}})}, 43);
  EXPECT_GT(swings.bare, 3.0);
  EXPECT_LT(swings.free, 1.05);
  EXPECT_LT(swings.counted, swings.free + 0.1);
}

EffectSpec Rod(double length) {
  EffectSpec spec = MakeSpec("sloshing_payload", {},
                             {{"mass", 0.05}, {"length", length}, {"damping", 1e-3}, {"radius", 0.01}});
  spec.options = {{"form", "rod"}, {"hinge", "y"}};
  return spec;
}

// Whether a mass on a rod goes on from window to window of an arm with `truth`, followed as its own law has
// it.
// `turned`: every other window has the same motion as angles of another branch. `bent`: by which its angles
// are off [rad], while all windows are met as before.
bool RodSwingsOn(const std::vector<EffectSpec>& truth, double length, uint64_t seed, bool turned = false,
                 double bent = 0) {
  const auto p = testing::Prepare("arm2", truth, seed);
  const FitSetting setting{p->data, p->nominal, p->scales};
  const Candidate c = Unfitted(setting, {Rod(length)}, false);
  const FitModel model{*c.plant, c.plant->parameters().Nominal(), {}};
  LiftedOptions options;
  double work = 0;
  NodeStates states =
      FollowedStates(p->data, model, options, InitialStates(p->data, model, options), true, &work);
  for (size_t w = 1; turned && w < states.size(); w += 2) {
    const Eigen::Index first = 2 * p->data.n;  // angle and rate about either axis
    states[w].row(first).array() += 3 * M_PI;
    states[w].row(first + 2) = (M_PI - states[w].row(first + 2).array()).matrix().eval();
    states[w].row(first + 3) *= -1;
  }
  options.iterations = 0;
  FitResult fit = Fit(p->data, model, options, &states);
  EXPECT_TRUE(fit.ok);
  for (size_t w = 1; w < states.size(); w += 2) fit.states[w].row(2 * p->data.n).array() += bent;
  const std::optional<bool> swings_on = SwingsOn(p->data, *c.plant, &fit, options);
  EXPECT_TRUE(swings_on.has_value());
  return swings_on.value_or(false);
}

TEST(SwingsOn, OnlyOfAMassThatIsThere) {
  EXPECT_TRUE(RodSwingsOn({Rod(0.12)}, 0.12, 45));
  EXPECT_TRUE(RodSwingsOn({Rod(0.12)}, 0.12, 45, true));
  EXPECT_FALSE(RodSwingsOn({Rod(0.12)}, 0.12, 45, false, 0.6));
  EXPECT_FALSE(RodSwingsOn({Rod(0.12)}, 0.03, 45)) << "at four times its length's pace";
  EXPECT_FALSE(RodSwingsOn({MakeSpec("coulomb_friction", {"shoulder"}, {{"coulomb", 0.2}})}, 0.12, 46));
}

// What hangs by chance at a window's start is not predicted for long by what went before.
TEST(SwingsOn, OfRecordingsKeptAsideToo) {
  const auto p = testing::Prepare("arm2", {Rod(0.12)}, 45);
  const auto held_out = PrepareHeldOut(p->set, p->data, p->nominal, p->options);
  ASSERT_NE(held_out, nullptr);
  const FitSetting setting{p->data, p->nominal, p->scales};
  for (const double length : {0.12, 0.03}) {
    Candidate c = Unfitted(setting, {Rod(length)}, false);
    c.fit.values = c.plant->parameters().Nominal();
    EXPECT_EQ(PredictHeldOut(*held_out, c, {}).swing_continues, length == 0.12) << length;
  }
}

// A motor behind play that starts anew in a window pays for how far that is from where the window before left
// it.
TEST(Jumps, AMotorBehindPlayPaysForWhereItStarts) {
  const std::string pivot = sysid::testing::LoadPlant("pendulum").joint_names()[0];
  EffectSpec play = MakeSpec("backlash", {pivot},
                             {{"gap", 0.03},
                              {"contact_stiffness", 800},
                              {"contact_damping", 1.5},
                              {"motor_inertia", 0.03},
                              {"motor_viscous", 0.001}});
  const auto p = testing::Prepare("pendulum", {play}, 3, {.rate_hz = 250});
  const auto plant = sim::Plant::Create(p->nominal.shared_model(), p->nominal.options(), {play});
  ASSERT_TRUE(plant.ok());
  EXPECT_TRUE(HasPlay(plant->effects()));
  EXPECT_FALSE(HasPlay({MakeSpec("coulomb_friction", {pivot}, {{"coulomb", 0.1}})}));
  const FitResult fit = Fit(p->data, FitModel{*plant, plant->parameters().Nominal(), {}}, {});
  ASSERT_TRUE(fit.ok);
  const FitResult counted = WithJumpsInPlay(p->data, *plant, fit, {});
  ASSERT_TRUE(counted.ok);
  EXPECT_NEAR(std::accumulate(counted.window_chi2.begin(), counted.window_chi2.end(), 0.0), counted.chi2,
              1e-9 * counted.chi2);
  EXPECT_EQ(counted.window_chi2[0], fit.window_chi2[0]) << "nothing goes before it";
  // Half the gap off, in one window.
  FitResult moved = fit;
  moved.states[2](2, 0) += 0.015;
  const FitResult paid = WithJumpsInPlay(p->data, *plant, moved, {});
  EXPECT_GT(paid.window_chi2[2], counted.window_chi2[2] + 10);
  EXPECT_EQ(paid.window_chi2[1], counted.window_chi2[1]);
}

}  // namespace
}  // namespace rg::diagnosis
