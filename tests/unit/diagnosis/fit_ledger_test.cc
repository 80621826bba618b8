#include "services/diagnosis/search/fit_ledger.h"

#include <gtest/gtest.h>

#include "common/base/clock.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/search/refinement.h"
#include "tests/unit/diagnosis/prepared_set.h"

namespace rg::diagnosis {
namespace {

using effects::EffectSpec;
using effects::MakeSpec;

// A pendulum with dry friction that drops with speed.
class FitLedgerTest : public ::testing::Test {
 protected:
  std::unique_ptr<testing::Prepared> p_ =
      testing::Prepare("pendulum",
                       {MakeSpec("stribeck_friction", {"hinge"},
                                 {{"coulomb", 0.1}, {"static", 0.3}, {"stribeck_velocity", 0.3}})},
                       41);
  const std::string joint_ = p_->nominal.joint_names()[0];
  FitSetting setting_{p_->data, p_->nominal, p_->scales};
  FakeClock clock_;
  Trace trace_{clock_};
  FitLedger ledger_{setting_, p_->options, 1, trace_, nullptr};
  Candidate coulomb_ = ledger_.Evaluate({MakeSpec("coulomb_friction", {joint_}, {{"coulomb", 0.2}})}, false);
};

TEST_F(FitLedgerTest, OtherLawsAreFittedInItsPlaceOnlyWhereATrialDoesNotRefuseThem) {
  ASSERT_TRUE(coulomb_.fit.ok);
  ASSERT_GT(ledger_.PerRow(coulomb_), 1.2);
  const auto others = Exchanges(Refreshed(coulomb_), "coulomb_friction", {}, p_->nominal, p_->scales);
  ASSERT_GT(others.size(), 3u);
  Candidate winner = coulomb_;
  ledger_.TryInPlace(others, &winner);
  EXPECT_EQ(winner.specs[0].id, "stribeck_friction");
  EXPECT_LT(ledger_.PerRow(winner), 1.1);
  EXPECT_LE(ledger_.tried().size(), 3u);  // with Coulomb friction itself
}

// So that a law which has nothing to do with what is left is not fitted on all windows.
TEST_F(FitLedgerTest, SomeWindowsTellWhatMayLeaveLess) {
  ASSERT_TRUE(coulomb_.fit.ok);
  const auto may = [&](const EffectSpec& spec) { return ledger_.MayLeaveLess(coulomb_, {spec}, false, 0.8); };
  EXPECT_TRUE(may(MakeSpec("stribeck_friction", {joint_},
                           {{"coulomb", 0.15}, {"static", 0.25}, {"stribeck_velocity", 0.2}})));
  EXPECT_FALSE(may(MakeSpec("coulomb_friction", {joint_}, {{"coulomb", 0.15}})));
  EXPECT_FALSE(may(MakeSpec("quadratic_drag", {joint_}, {{"quadratic", 0.05}})));
  EXPECT_EQ(ledger_.tried().size(), 1u) << "no fit of some windows is an account";
}

// Additions to a model that is not consistent begin at the base parameters that it has found, not at those of
// short pieces without its effects.
TEST_F(FitLedgerTest, FitsNearAModelBeginWhereItHasCome) {
  const Candidate freed = ledger_.Evaluate(Refreshed(coulomb_), true, &coulomb_);
  ASSERT_TRUE(freed.fit.ok);
  ASSERT_GT(ledger_.PerRow(coulomb_), 1.2);
  ledger_.FindPieces({});
  const auto pieces = ledger_.Start(nullptr, true);
  ASSERT_NE(pieces, nullptr);
  ledger_.SetNoiseScale(0.5 * ledger_.PerRow(freed) / kConsistent);  // so that it leaves too much
  const auto start = ledger_.Start(&freed, true);
  ASSERT_NE(start, nullptr);
  EXPECT_EQ(start->fit.values, freed.fit.values);
  EXPECT_TRUE(start->fit.states.empty()) << "where the recordings are, not where the model is";
  EXPECT_EQ(ledger_.Start(&freed, false), nullptr) << "base parameters as given";
  EXPECT_EQ(ledger_.Start(&coulomb_, true), pieces) << "it has found none";
  ledger_.SetNoiseScale(2 * ledger_.PerRow(freed) * ledger_.noise_scale());
  EXPECT_EQ(ledger_.Start(&freed, true)->fit.states.size(), freed.fit.states.size());
}

// Most iterations are made on a few windows, and what comes out is what all of them say.
TEST_F(FitLedgerTest, AFitFromFarOffToManyWindowsFindsItsWayOnFew) {
  FitData many = p_->data;
  while (many.windows.size() < 60)
    many.windows.insert(many.windows.end(), p_->data.windows.begin(), p_->data.windows.end());
  const FitSetting setting{many, p_->nominal, p_->scales};
  FitRequest request{{MakeSpec("stribeck_friction", {joint_},
                               {{"coulomb", 1.0}, {"static", 1.5}, {"stribeck_velocity", 0.05}})}};
  request.options.iterations = 12;
  const FitResult found = MakeFit(setting, request);
  const Candidate c = Unfitted(setting, request.specs, false);
  const FitResult direct =
      Fit(many, {*c.plant, c.plant->parameters().Nominal(), c.parameters}, request.options);
  ASSERT_TRUE(found.ok && direct.ok);
  EXPECT_LT(found.work, 0.8 * direct.work);
  EXPECT_NEAR(found.chi2, direct.chi2, 1e-3 * direct.chi2);
  for (int i = 0; i < direct.theta.size(); ++i)
    EXPECT_NEAR(found.theta[i], direct.theta[i], 0.1 * direct.stddev[i]) << i;
}

// Counts what is asked of it.
class CountedFits final : public FitExecutor {
 public:
  std::unique_ptr<FitBatch> Start(const FitSetting& setting, std::vector<FitRequest> requests) override {
    asked += requests.size();
    return local_.Start(setting, std::move(requests));
  }
  size_t asked = 0;

 private:
  LocalFits local_;
};

TEST_F(FitLedgerTest, TheSameFitIsMadeOnceAndAnotherStartIsAnotherFit) {
  CountedFits counted;
  RememberedFits fits(counted);
  const auto request = [&](double level) {
    return FitRequest{{MakeSpec("coulomb_friction", {joint_}, {{"coulomb", level}})},
                      false,
                      ledger_.lifted(),
                      {},
                      0,
                      false,
                      nullptr};
  };
  const FitResult first = fits.Start(setting_, {request(0.2)})->Take(0);
  const auto batch = fits.Start(setting_, {request(0.3), request(0.2), request(0.3)});
  EXPECT_EQ(counted.asked, 2u);
  const FitResult again = batch->Take(1);
  EXPECT_GT(first.work, 0);
  EXPECT_EQ(again.work, 0);
  EXPECT_EQ(again.values, first.values);
  EXPECT_EQ(again.chi2, first.chi2);
  EXPECT_GT(batch->Take(2).work, 0);
  EXPECT_EQ(batch->Take(0).work, 0);
  fits.Forget();
  fits.Start(setting_, {request(0.2)});
  EXPECT_EQ(counted.asked, 3u);
}

// A fit may end before it is done: others that go on from there would be credited with the rest of its way.
TEST(FitLedger, WhatIsAtHandIsFittedOnBeforeAnotherTakesItsPlace) {
  const auto p =
      testing::Prepare("pendulum", {MakeSpec("coulomb_friction", {"hinge"}, {{"coulomb", 0.2}})}, 44);
  const FitSetting setting{p->data, p->nominal, p->scales};
  const FakeClock clock;
  const Trace trace(clock);
  FitLedger ledger(setting, p->options, 1, trace, nullptr);
  const std::string joint = p->nominal.joint_names()[0];
  Candidate winner = ledger.Evaluate({MakeSpec("coulomb_friction", {joint}, {{"coulomb", 0.1}})}, false);
  ASSERT_TRUE(winner.fit.ok);
  const double done = winner.score;
  winner.score -= 30;
  const auto others = Exchanges(Refreshed(winner), "coulomb_friction", {}, p->nominal, p->scales);
  ledger.TryInPlace(others, &winner);
  EXPECT_EQ(winner.specs[0].id, "coulomb_friction");
  EXPECT_GT(winner.score, done - 1);
  EXPECT_GT(ledger.tried().size(), 1u) << "others were fitted";
}

// Drag stood for viscous friction: beside that it is about nothing, and viscous friction alone is tried.
TEST(FitLedger, WhatStoodForAnotherLawIsTakenOutBesideIt) {
  const auto p =
      testing::Prepare("pendulum", {MakeSpec("viscous_friction", {"hinge"}, {{"viscous", 0.2}})}, 45);
  const FitSetting setting{p->data, p->nominal, p->scales};
  const FakeClock clock;
  const Trace trace(clock);
  FitLedger ledger(setting, p->options, 1, trace, nullptr);
  const EffectSpec drag = MakeSpec("quadratic_drag", {"hinge"}, {{"quadratic", 0.05}});
  const EffectSpec viscous = MakeSpec("viscous_friction", {"hinge"}, {{"viscous", 0.1}});
  Candidate winner =
      ledger.Evaluate({MakeSpec("coulomb_friction", {"hinge"}, {{"coulomb", 0.1}}), drag}, false);
  ASSERT_TRUE(winner.fit.ok);
  ASSERT_GT(Strength(winner, 1), 10);
  ledger.TryInPlace({{viscous, drag}}, &winner);
  EXPECT_EQ(KeyOf(winner.specs), KeyOf({viscous}));
}

TEST_F(FitLedgerTest, WhatIsPromisedIsFittedOnAllWindowsWithoutATrial) {
  const TrialSpecs viscous = {MakeSpec("viscous_friction", {joint_}, {{"viscous", 0.01}})};
  Candidate winner = coulomb_;
  ledger_.TryBest(coulomb_, {}, {viscous}, 3, &winner);
  const Candidate* both = ledger_.Known(Joined(coulomb_.specs, viscous), false);
  ASSERT_NE(both, nullptr);
  EXPECT_EQ(winner.score, std::max(coulomb_.score, both->score));
}

// A law that was fitted before is no reason to keep a worse one.
TEST_F(FitLedgerTest, WhatIsExchangedIsComparedWithWhatWasFittedBefore) {
  const ProgressFn progress;
  SearchState state(setting_, p_->options, 1, clock_, progress, nullptr);
  FitLedger& fits = state.fits;
  const Candidate known =
      fits.Evaluate({MakeSpec("stribeck_friction", {joint_},
                              {{"coulomb", 0.1}, {"static", 0.3}, {"stribeck_velocity", 0.3}})},
                    false);
  ASSERT_TRUE(known.fit.ok);
  Candidate model = coulomb_;
  Refinement refinement(state);
  ASSERT_TRUE(refinement.Exchange(Candidate{}, &model));
  EXPECT_EQ(model.specs[0].id, "stribeck_friction");
  EXPECT_TRUE(refinement.IsSettled(model));
  model.base = true;
  EXPECT_FALSE(refinement.IsSettled(model)) << "beside other base parameters it may be another";
}

TEST_F(FitLedgerTest, ASwingingMassIsAnAccountOnlyWhereItHolds) {
  const effects::EffectSpec mass = MakeSpec("sloshing_payload", {}, {{"mass", 0.05}}),
                            drag = MakeSpec("quadratic_drag", {joint_}, {{"quadratic", 0.01}});
  const Candidate both = ledger_.Evaluate({drag, mass}, false), alone = ledger_.Evaluate({mass}, false);
  ASSERT_GT(ledger_.PerRow(both), kConsistent);
  ASSERT_GT(ledger_.PerRow(alone), kConsistent);
  const Candidate nothing = ledger_.Evaluate({}, false);
  EXPECT_LT(both.score, nothing.score);
  EXPECT_LT(alone.score, nothing.score);
  EXPECT_LT(alone.fit.chi2, nothing.fit.chi2) << "though it follows some of it";
}

// Its one parameter is known well: half of its information takes half of log 2 off the Occam factor.
TEST_F(FitLedgerTest, AllScoresAreBroughtToAnotherNoise) {
  const double before = coulomb_.score;
  ledger_.SetNoiseScale(2.0);
  EXPECT_NEAR(ledger_.Known(coulomb_.specs, false)->score,
              before + 0.25 * coulomb_.fit.chi2 + 0.5 * std::log(2.0), 0.001);
  EXPECT_EQ(ledger_.Known(coulomb_.specs, true), nullptr);
}

TEST_F(FitLedgerTest, WhatComesNextHasItsShareOfTheWork) {
  const double limit = p_->options.work_limit;
  ledger_.Grant(0.5);
  ledger_.AddWork(0.9 * limit);
  EXPECT_FALSE(ledger_.Late()) << "a share of what is there anyway adds nothing";
  ledger_.Grant(0.5);
  ledger_.AddWork(0.4 * limit);
  EXPECT_FALSE(ledger_.Late());
  ledger_.AddWork(0.2 * limit);
  EXPECT_TRUE(ledger_.Late());
}

TEST_F(FitLedgerTest, NothingNewIsBegunBeyondTheLimitOfWork) {
  EXPECT_GT(ledger_.work(), 0);
  EXPECT_FALSE(ledger_.Late());
  ledger_.AddWork(p_->options.work_limit);
  EXPECT_TRUE(ledger_.Late());
  EXPECT_FALSE(ledger_.Late(1.1));
  Candidate winner = coulomb_;
  ledger_.AddWork(p_->options.work_limit);
  ledger_.TryInPlace(Exchanges(Refreshed(coulomb_), "coulomb_friction", {}, p_->nominal, p_->scales),
                     &winner);
  EXPECT_EQ(winner.specs[0].id, "coulomb_friction");
  EXPECT_EQ(ledger_.tried().size(), 1u);
}

}  // namespace
}  // namespace rg::diagnosis
