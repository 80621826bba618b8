#include "services/diagnosis/findings.h"

#include <gtest/gtest.h>

#include <cmath>

#include "common/base/clock.h"
#include "tests/unit/diagnosis/prepared_set.h"

namespace rg::diagnosis {
namespace {

// What is said where nothing was found and χ² is `beyond` times what a true model would leave.
std::string VerdictBeyond(double beyond) {
  const auto p = testing::Prepare("pendulum", {}, 5, {.rate_hz = 250});
  SearchResult search =
      SearchEffects(p->data, p->nominal, p->scales, p->options, 1, RealClock(), {}, nullptr);
  EXPECT_TRUE(search.best.specs.empty());
  for (Candidate* c : {&search.nominal, &search.calibrated, &search.best}) c->fit.chi2 *= 1.3;
  search.own_chi2 = search.best.fit.chi2 / beyond;
  // Beyond what chance makes of the null.
  EXPECT_GT(search.best.fit.chi2, search.own_chi2 + kOnePercent * std::sqrt(4.0 * search.best.fit.rows));
  DiagnosisResult result;
  result.joints = p->set.joints;
  Conclude(search, p->data, p->nominal, p->scales, &result);
  return result.verdict;
}

TEST(Verdict, WithoutAnyForceALittleMoreThanTheNoiseIsNoMismatch) {
  EXPECT_EQ(VerdictBeyond(1.09), "no_mismatch");
  EXPECT_EQ(VerdictBeyond(1.5), "unexplained");
}

// What a name was preferred to for having fewer is no reason to doubt it.
TEST(Confidence, IsNotLessForARivalWithMoreNamesThatTheyDoNotPayFor) {
  const auto p =
      testing::Prepare("pendulum", {effects::MakeSpec("viscous_friction", {"hinge"}, {{"viscous", 0.2}})}, 6);
  SearchResult search =
      SearchEffects(p->data, p->nominal, p->scales, p->options, 1, RealClock(), {}, nullptr);
  ASSERT_EQ(search.best.specs.size(), 1u);
  const auto beside = [&](const std::vector<std::string>& rival) {
    SearchResult with = search;
    with.beside = 10;
    Candidate c = search.best;
    c.specs.clear();
    for (const std::string& id : rival) c.specs.push_back(effects::MakeSpec(id, {"hinge"}));
    c.score = search.best.score + 5;
    with.tried.push_back(c);
    DiagnosisResult result;
    result.joints = p->set.joints;
    Conclude(with, p->data, p->nominal, p->scales, &result);
    return result.findings.at(0).confidence;
  };
  EXPECT_GT(beside({"coulomb_friction", "quadratic_drag"}), 0.9);
  EXPECT_LT(beside({"coulomb_friction"}), 0.1);
}

// By the evidence of a force on each joint alone and on both.
TEST(Unexplained, NamesASecondJointWhereItTakesAGoodPartOfTheRest) {
  const auto p = testing::Prepare("arm2", {}, 5);
  SearchResult search =
      SearchEffects(p->data, p->nominal, p->scales, p->options, 1, RealClock(), {}, nullptr);
  search.best.fit.chi2 *= 2, search.nominal.fit.chi2 *= 2, search.calibrated.fit.chi2 *= 2;
  const auto joints_by = [&](const Eigen::Matrix2d& evidence) {
    search.remaining.evidence = evidence;
    DiagnosisResult result;
    result.joints = p->set.joints;
    Conclude(search, p->data, p->nominal, p->scales, &result);
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
