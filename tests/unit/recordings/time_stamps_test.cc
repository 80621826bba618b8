#include "common/recordings/time_stamps.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

namespace rg::recordings {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

Recording At(double rate_hz, double seconds, double units_per_s, double start_s, bool with_velocity) {
  Recording r;
  r.name = "rec.csv";
  r.joints = {"a"};
  const int rows = static_cast<int>(rate_hz * seconds);
  r.t.resize(rows);
  r.q.resize(1, rows);
  if (with_velocity) r.v.resize(1, rows);
  for (int k = 0; k < rows; ++k) {
    const double t = k / rate_hz;
    r.t[k] = (start_s + t) * units_per_s;
    r.q(0, k) = std::sin(2 * t);
    if (with_velocity) r.v(0, k) = 2 * std::cos(2 * t);
  }
  return r;
}

TEST(CheckTimeUnit, NamesTheUnitAtAnyUsualRate) {
  const struct {
    const char* name;
    const char* flag;
    double per_s;
  } units[] = {{"milliseconds", "ms", 1e3}, {"microseconds", "us", 1e6}, {"nanoseconds", "ns", 1e9}};
  for (const auto& unit : units) {
    for (const double rate : {20.0, 25.0, 100.0, 500.0, 1000.0}) {
      for (const double start : {0.0, 12.5, 1637836800.0}) {
        for (const bool velocity : {false, true}) {
          const Recording r = At(rate, 20, unit.per_s, start, velocity);
          EXPECT_THAT(CheckTimeUnit(r, std::nullopt).message(),
                      AllOf(HasSubstr("rec.csv: row 1, column time"), HasSubstr(unit.name),
                            HasSubstr(std::string("--time-unit ") + unit.flag)))
              << unit.name << " " << rate << " Hz from " << start << " velocity " << velocity;
          EXPECT_THAT(CheckTimeUnit(r, rate).message(), HasSubstr(unit.name));
        }
      }
    }
  }
}

TEST(CheckTimeUnit, LetsSecondsPass) {
  for (const double rate : {2.0, 5.0, 10.0, 25.0, 100.0, 1000.0, 10000.0}) {
    for (const double start : {0.0, 1637836800.0}) {
      for (const bool velocity : {false, true}) {
        EXPECT_TRUE(CheckTimeUnit(At(rate, 20, 1, start, velocity), std::nullopt).ok()) << rate;
        EXPECT_TRUE(CheckTimeUnit(At(rate, 20, 1, start, velocity), rate).ok()) << rate;
      }
    }
  }
}

TEST(TimeUnitsPerSecond, KnowsFour) {
  EXPECT_EQ(*TimeUnitsPerSecond("us"), 1e6);
  EXPECT_THAT(TimeUnitsPerSecond("min").status().message(), HasSubstr("must be s, ms, us or ns"));
}

Recording WithGaps() {
  Recording r = At(100, 10, 1, 5.0, true);
  r.effort_command = Eigen::MatrixXd::Constant(1, r.rows(), 2.0);
  r.other["battery"] = Eigen::VectorXd::LinSpaced(r.rows(), 0, 1);
  r.t.tail(600).array() += 37.0;
  r.t.tail(200).array() += 0.2;
  return r;
}

TEST(FindGaps, AreLongerThanFivePeriodsAndATenthOfASecond) {
  const std::vector<Gap> gaps = FindGaps(WithGaps().t);
  ASSERT_EQ(gaps.size(), 2u);
  EXPECT_EQ(gaps[0].row, 400);
  EXPECT_NEAR(gaps[0].seconds, 37.01, 1e-9);
  EXPECT_EQ(gaps[1].row, 800);
  Recording lost = At(100, 10, 1, 0, false);
  lost.t.tail(500).array() += 0.085;
  EXPECT_TRUE(FindGaps(lost.t).empty()) << "some lost rows";
  Recording slow = At(25, 10, 1, 0, false);
  slow.t.tail(100).array() += 0.15;
  EXPECT_TRUE(FindGaps(slow.t).empty()) << "0.19 s are no gap at 25 Hz";
}

TEST(SplitAtGaps, PiecesAreTheRowsBetweenAndJoinAgain) {
  const Recording r = WithGaps();
  const std::vector<Recording> pieces = SplitAtGaps(r);
  ASSERT_EQ(pieces.size(), 3u);
  EXPECT_EQ(pieces[0].rows() + pieces[1].rows() + pieces[2].rows(), r.rows());
  for (const Recording& piece : pieces) {
    EXPECT_EQ(piece.name, "rec.csv");
    EXPECT_EQ(piece.window_origin, 5.0);
    EXPECT_TRUE(FindGaps(piece.t).empty());
  }
  const std::vector<Recording> whole = JoinPieces(pieces);
  ASSERT_EQ(whole.size(), 1u);
  EXPECT_EQ(whole[0].t, r.t);
  EXPECT_EQ(whole[0].q, r.q);
  EXPECT_EQ(whole[0].v, r.v);
  EXPECT_EQ(whole[0].effort_command, r.effort_command);
  EXPECT_EQ(whole[0].other.at("battery"), r.other.at("battery"));
}

}  // namespace
}  // namespace rg::recordings
