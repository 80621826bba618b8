#include "common/recordings/windows.h"

#include <gtest/gtest.h>

#include "common/recordings/recording.h"

#include <limits>

namespace rg::recordings {
namespace {

Eigen::VectorXd Grid(int rows, double period, double start = 0.0) {
  Eigen::VectorXd t(rows);
  for (int k = 0; k < rows; ++k) t[k] = start + period * k;
  return t;
}

TEST(SplitIntoWindows, RestartsEveryWindowOnAGridWhateverItsOffset) {
  for (const double start : {0.0, 0.1, 1234.567, -3.3}) {
    const auto windows = SplitIntoWindows(Grid(301, 0.01, start), 1.0);
    ASSERT_EQ(windows.size(), 3u);
    for (int w = 0; w < 3; ++w) {
      EXPECT_EQ(windows[static_cast<size_t>(w)].first, 100 * w);
      EXPECT_EQ(windows[static_cast<size_t>(w)].last, 100 * (w + 1));
    }
  }
}

TEST(SplitIntoWindows, KeepsAShorterLastWindow) {
  const auto windows = SplitIntoWindows(Grid(31, 0.04), 1.0);
  ASSERT_EQ(windows.size(), 2u);
  EXPECT_EQ(windows[1].first, 25);
  EXPECT_EQ(windows[1].last, 30);
}

TEST(SplitIntoWindows, CoversEveryRowButTheFirstExactlyOnce) {
  Eigen::VectorXd t = Grid(500, 0.0103);
  for (Eigen::Index k = 200; k < t.size(); ++k) t[k] += 2.7;  // a gap that swallows two windows
  const auto windows = SplitIntoWindows(t, 1.0);
  int next = 0;
  for (const Window& w : windows) {
    EXPECT_EQ(w.first, next);
    EXPECT_GT(w.rows(), 0);
    next = w.last;
  }
  EXPECT_EQ(next, 499);
}

TEST(SplitIntoWindows, TakesTheFirstRowWithinHalfASampleOfTheBoundary) {
  Eigen::VectorXd t(6);
  t << 0.0, 0.5, 0.996, 1.001, 1.5, 2.0;  // median period 0.5: 0.996 is near enough to 1.0
  const auto windows = SplitIntoWindows(t, 1.0);
  ASSERT_GE(windows.size(), 1u);
  EXPECT_EQ(windows[0].last, 2);
}

TEST(SplitIntoWindows, IsOneWindowForAnInfiniteLengthAndNoneForASingleRow) {
  const auto windows = SplitIntoWindows(Grid(50, 0.04), std::numeric_limits<double>::infinity());
  ASSERT_EQ(windows.size(), 1u);
  EXPECT_EQ(windows[0].last, 49);
  EXPECT_TRUE(SplitIntoWindows(Grid(1, 0.04), 1.0).empty());
}

TEST(SplitIntoWindows, OfAPieceAreCountedFromTheRecordingsFirstRow) {
  Recording r;
  r.t = Eigen::VectorXd::LinSpaced(301, 7.3, 10.3);
  r.window_origin = 5.0;
  const auto windows = SplitIntoWindows(r, 1.0);
  ASSERT_EQ(windows.size(), 4u);
  EXPECT_EQ(windows[0].first, 0);
  EXPECT_NEAR(r.t[windows[1].first], 8.0, 1e-9);
  EXPECT_NEAR(r.t[windows[3].first], 10.0, 1e-9);
}

}  // namespace
}  // namespace rg::recordings
