#include "services/diagnosis/reporting/findings.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>

#include "common/base/clock.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/reporting/experiments.h"
#include "services/diagnosis/reporting/holdout.h"
#include "services/diagnosis/search/search.h"
#include "tests/unit/diagnosis/prepared_set.h"

namespace rg::diagnosis {
namespace {

SearchResult Searched(const testing::Prepared& p) {
  return SearchEffects({p.data, p.nominal, p.scales}, p.options, 1, RealClock(), {}, nullptr);
}

// What is said where nothing was found and χ² is `beyond` times what a true model would leave.
std::string VerdictBeyond(double beyond) {
  const auto p = testing::Prepare("pendulum", {}, 5, {.rate_hz = 250});
  SearchResult search = Searched(*p);
  EXPECT_TRUE(search.best.specs.empty());
  for (Candidate* c : {&search.nominal, &search.calibrated, &search.best}) c->fit.chi2 *= 1.3;
  search.own_chi2 = search.best.fit.chi2 / beyond;
  // Beyond what chance makes of the null.
  EXPECT_GT(search.best.fit.chi2, search.own_chi2 + kZ99OneSided * std::sqrt(4.0 * search.best.fit.rows));
  DiagnosisResult result;
  result.joints = p->set.joints;
  Conclude(search, {p->data, p->nominal, p->scales}, &result);
  return result.verdict;
}

TEST(Verdict, WithoutAnyForceALittleMoreThanTheNoiseIsNoMismatch) {
  EXPECT_EQ(VerdictBeyond(1.09), "no_mismatch");
  EXPECT_EQ(VerdictBeyond(1.5), "unexplained");
}

// Confidence of the first finding where `rival`, which scores by `more` better, was fitted too.
double ConfidenceBeside(const testing::Prepared& p, SearchResult search,
                        std::vector<effects::EffectSpec> rival, double more) {
  Candidate c = search.best;
  c.specs = std::move(rival), c.score += more;
  search.tried.push_back(c);
  DiagnosisResult result;
  result.joints = p.set.joints;
  Conclude(search, {p.data, p.nominal, p.scales}, &result);
  return result.findings.at(0).confidence;
}

// What a name was preferred to for having fewer is no reason to doubt it.
TEST(Confidence, IsNotLessForARivalWithMoreNamesThatTheyDoNotPayFor) {
  const auto p =
      testing::Prepare("pendulum", {effects::MakeSpec("viscous_friction", {"hinge"}, {{"viscous", 0.2}})}, 6);
  SearchResult search = Searched(*p);
  ASSERT_EQ(search.best.specs.size(), 1u);
  search.beside = 10;
  const auto coulomb = effects::MakeSpec("coulomb_friction", {"hinge"});
  EXPECT_GT(ConfidenceBeside(*p, search, {coulomb, effects::MakeSpec("quadratic_drag", {"hinge"})}, 5), 0.9);
  EXPECT_LT(ConfidenceBeside(*p, search, {coulomb}, 5), 0.1);
}

// A name that explains nearly all is kept, and what it leaves beyond the noise is said to be there.
TEST(Verdict, IsUnexplainedWhereTheBestModelIsInconsistentWithTheNoise) {
  const auto p =
      testing::Prepare("pendulum", {effects::MakeSpec("viscous_friction", {"hinge"}, {{"viscous", 0.2}})}, 6);
  SearchResult search = Searched(*p);
  ASSERT_EQ(search.best.specs.size(), 1u);
  const double consistent = search.best.fit.chi2;
  for (const double left : {1.0, 3.0}) {
    search.best.fit.chi2 = left * consistent;
    ASSERT_GT(search.nominal.fit.chi2, 10 * search.best.fit.chi2);
    DiagnosisResult result;
    result.joints = p->set.joints;
    Conclude(search, {p->data, p->nominal, p->scales}, &result);
    std::set<std::string> names;
    for (const Finding& f : result.findings) names.insert(f.effect);
    EXPECT_EQ(names.count("viscous_friction"), 1u);
    EXPECT_EQ(names.count("unknown_field"), left > 1 ? 1u : 0u);
    EXPECT_EQ(result.verdict, left > 1 ? "unexplained" : "unmodelled_physics");
    EXPECT_TRUE((result.findings[0].confidence > 0.8) == (left == 1.0)) << result.findings[0].confidence;
  }
}

// A richer form may score better and yet not be claimed: it has the law too, but only where it is.
TEST(Confidence, OfPlainFrictionIsNotLessForARicherFormThere) {
  for (const char* robot : {"pendulum", "arm2"}) {
    const std::string joint = robot == std::string("pendulum") ? "hinge" : "elbow";
    const auto p =
        testing::Prepare(robot, {effects::MakeSpec("coulomb_friction", {joint}, {{"coulomb", 0.2}})}, 6);
    const SearchResult search = Searched(*p);
    ASSERT_EQ(KeyOf(search.best.specs), "coulomb_friction[" + joint + " ] ");
    const auto beside = [&](const std::string& on) {
      return ConfidenceBeside(*p, search, {effects::MakeSpec("stribeck_friction", {on})}, 20);
    };
    EXPECT_GT(beside(joint), 0.7) << robot;
    if (joint != "elbow") continue;
    EXPECT_LT(beside("shoulder"), 0.1) << "a model without friction of the elbow is the likelier";
  }
}

TEST(WorseThanCalibrated, TakesMoreThanOneWindowThatChanceMayHaveMade) {
  HoldoutFit h;
  h.before_rms = 1.0, h.calibrated_rms = 0.10, h.after_rms = 0.12;
  h.worse_than_calibrated = 0.7;
  EXPECT_FALSE(WorseThanCalibrated(h));
  h.worse_than_calibrated = 0.99;
  EXPECT_TRUE(WorseThanCalibrated(h));
  h.after_rms = 0.105;
  EXPECT_FALSE(WorseThanCalibrated(h)) << "by too little to matter";
  h.after_rms = 0.12, h.before_rms = 0.1, h.worse_than_calibrated = 0.7;
  EXPECT_TRUE(WorseThanCalibrated(h)) << "nothing is given that is worse than what was there";
  h.judged_on_fit = true;
  EXPECT_FALSE(WorseThanCalibrated(h));
}

TEST(Experiment, IsWhatShowsTheRarerOfTwoLawsBest) {
  const std::string ramps = "slow ramps of hinge at 0.01 to 0.05 rad/s through several reversals";
  EXPECT_EQ(ExperimentFor("coulomb_friction", "stribeck_friction", {"hinge"}), ramps);
  EXPECT_EQ(ExperimentFor("stribeck_friction", "coulomb_friction", {"hinge"}), ramps);
  EXPECT_EQ(ExperimentFor("base_flexibility", "sloshing_payload", {}),
            "a chirp of the joints through 2 to 20 Hz at high sample rate");
  EXPECT_EQ(ExperimentFor("contact", "unknown_field", {"a", "b"}),
            "a slow sweep of a and b through the whole range in both directions");
}

TEST(Tables, ShowWhatParametersHadTakenInAndWhatElseWasTried) {
  const auto p =
      testing::Prepare("pendulum", {effects::MakeSpec("coulomb_friction", {"hinge"}, {{"coulomb", 0.1}})}, 7);
  const SearchResult search = Searched(*p);
  ASSERT_EQ(search.best.specs.size(), 1u);
  ASSERT_FALSE(search.best.base);
  const std::vector<LedgerRow> ledger = LedgerOf(search);
  ASSERT_EQ(ledger.size(), search.calibrated.parameters.size());
  double last = std::numeric_limits<double>::infinity();
  for (const LedgerRow& row : ledger) {
    EXPECT_EQ(row.final, row.nominal) << row.name;
    const double moved = std::abs(row.final - row.calibrated) / row.prior_stddev;
    EXPECT_LE(moved, last);
    last = moved;
  }
  EXPECT_GT(std::abs(ledger[0].final - ledger[0].calibrated), 0) << "damping had taken the friction in";
  const std::vector<CandidateRow> rows = CandidateRows(search);
  ASSERT_GT(rows.size(), 2u);
  EXPECT_LE(rows.size(), kMostCandidates);
  EXPECT_EQ(std::count_if(rows.begin(), rows.end(), [](const CandidateRow& r) { return r.chosen; }), 1);
  EXPECT_TRUE(std::is_sorted(rows.begin(), rows.end(), [](const CandidateRow& a, const CandidateRow& b) {
    return a.evidence > b.evidence;
  }));
  const std::vector<ForcePlot> plots = ForcePlots(search, p->data);
  ASSERT_EQ(plots.size(), p->data.recordings.size());
  // Friction by its level, less the damping that had taken part of it in.
  Eigen::Matrix2d gram = Eigen::Matrix2d::Zero();
  Eigen::Vector2d taken = Eigen::Vector2d::Zero();
  for (const ForcePlot& plot : plots) {
    ASSERT_EQ(plot.force.cols(), static_cast<Eigen::Index>(plot.t.size()));
    for (Eigen::Index k = 0; k < plot.v.cols(); ++k) {
      const Eigen::Vector2d of(plot.v(0, k) > 0 ? -1.0 : 1.0, plot.v(0, k));
      gram += of * of.transpose(), taken += plot.explained(0, k) * of;
    }
  }
  const Eigen::Vector2d law = gram.ldlt().solve(taken);
  EXPECT_NEAR(law[0], 0.1, 0.02);
  EXPECT_GT(law[1], 0);
}

// By the evidence of a force on each joint alone and on both.
TEST(Unexplained, NamesASecondJointWhereItTakesAGoodPartOfTheRest) {
  const auto p = testing::Prepare("arm2", {}, 5);
  SearchResult search = Searched(*p);
  search.best.fit.chi2 *= 2, search.nominal.fit.chi2 *= 2, search.calibrated.fit.chi2 *= 2;
  const auto joints_by = [&](const Eigen::Matrix2d& evidence) {
    search.remaining.evidence = evidence;
    DiagnosisResult result;
    result.joints = p->set.joints;
    Conclude(search, {p->data, p->nominal, p->scales}, &result);
    EXPECT_EQ(result.verdict, "unexplained");
    return result.findings.at(0).joints;
  };
  using Joints = std::vector<std::string>;
  EXPECT_EQ(joints_by(Eigen::Matrix2d{{100, 110}, {110, 20}}), Joints{"shoulder"});
  EXPECT_EQ(joints_by(Eigen::Matrix2d{{20, 110}, {110, 100}}), Joints{"elbow"});
  EXPECT_EQ(joints_by(Eigen::Matrix2d{{100, 160}, {160, 20}}), (Joints{"shoulder", "elbow"}));
}

}  // namespace
}  // namespace rg::diagnosis
