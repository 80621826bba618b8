#include "services/proof/reliability.h"

#include <gtest/gtest.h>

namespace rg::proof {
namespace {

// A case with `n` findings said at `confidence`, of which the first `right` hold.
CaseMarks Case(CaseKind kind, double confidence, int n, int right,
               const std::string& effect = "torque_gain") {
  CaseMarks c;
  c.kind = kind;
  for (int i = 0; i < n; ++i) {
    c.said.push_back(effect + " [elbow] 0.90");
    c.calls.push_back({confidence, i < right});
  }
  return c;
}

TEST(Reliability, OrdinaryRobotsAreHalfHoweverManyThereAre) {
  // One ordinary robot whose findings are all wrong, four others whose findings are right.
  std::vector<CaseMarks> cases = {Case(CaseKind::kOrdinary, 0.9, 2, 0)};
  for (int i = 0; i < 4; ++i) cases.push_back(Case(CaseKind::kSingle, 0.9, 2, 2));
  const Reliability r = ReliabilityOf({{"one", cases}});
  ASSERT_EQ(r.levels.size(), 1u);
  EXPECT_EQ(r.levels[0].right.value, 0.8);
  EXPECT_NEAR(r.levels[0].mixed, 0.5, 1e-12);
  EXPECT_NEAR(r.as_said.calibration_error, 0.4, 1e-12);
  EXPECT_NEAR(r.as_said.brier, 0.5 * 0.81 + 0.5 * 0.01, 1e-12);
}

TEST(Reliability, ALevelIsJudgedByTheOtherExaminationsAlone) {
  // Said at 0.5, right in every other examination: left out, each is said nearer to one, and what one
  // examination says of itself alone changes nothing.
  const auto all = [](int right) {
    return std::vector<CaseMarks>{Case(CaseKind::kSingle, 0.5, 8, right),
                                  Case(CaseKind::kOrdinary, 0.5, 8, right)};
  };
  const Reliability alone = ReliabilityOf({{"a", all(8)}});
  EXPECT_NEAR(alone.left_out.brier, alone.as_said.brier, 1e-12);
  const Reliability both = ReliabilityOf({{"a", all(8)}, {"b", all(8)}});
  EXPECT_NEAR(both.as_said.brier, 0.25, 1e-12);
  EXPECT_NEAR(both.left_out.brier, 1.0 / 18 / 18, 1e-12);  // at (16 + 1) / (16 + 2)
  const Reliability differ = ReliabilityOf({{"a", all(8)}, {"b", all(0)}});
  EXPECT_GT(differ.left_out.brier, differ.as_said.brier) << "the other examination misleads";
}

TEST(Reliability, KindsOfFindingsHaveLevelsOfTheirOwn) {
  const Reliability r = ReliabilityOf(
      {{"a",
        {Case(CaseKind::kSingle, 0.8, 5, 5), Case(CaseKind::kOpen, 0.8, 5, 3, "unknown_field"),
         Case(CaseKind::kControl, 0.95, 2, 2, "parameters_only"), Case(CaseKind::kSingle, 0.96, 1, 1)}}});
  ASSERT_EQ(r.levels.size(), 4u);
  EXPECT_EQ(r.levels[0].kind + " " + r.levels[1].kind, "name name");
  EXPECT_EQ(r.levels[0].said, 0.96);
  EXPECT_EQ(r.levels[3].kind, "unnamed");
  EXPECT_EQ(r.levels[3].right.value, 0.6);
  EXPECT_EQ(r.bins[4].right.n, 13);
  const std::string svg = ReliabilitySvg(r);
  EXPECT_NE(svg.find("unnamed said at 0.8: 5 findings, 0.6 right"), std::string::npos) << svg;
  EXPECT_EQ(svg.find("parameters said"), std::string::npos) << "two findings are no point";
}

}  // namespace
}  // namespace rg::proof
