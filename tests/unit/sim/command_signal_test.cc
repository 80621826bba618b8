#include "common/sim/command_signal.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace rg::sim {
namespace {

CommandSignal Ramp(Hold hold) {
  Eigen::MatrixXd u(1, 4);
  u << 0, 1, 3, 2;
  return CommandSignal::Create({0, 1, 2, 4}, u, hold).value();
}

TEST(CommandSignal, HoldsOrInterpolatesBetweenRows) {
  EXPECT_EQ(Ramp(Hold::kZeroOrder).At(0, 1.999), 1.0);
  EXPECT_EQ(Ramp(Hold::kZeroOrder).At(0, 2.0), 3.0);
  EXPECT_DOUBLE_EQ(Ramp(Hold::kLinear).At(0, 3.0), 2.5);
  EXPECT_EQ(Ramp(Hold::kLinear).At(0, -5.0), 0.0);
  EXPECT_EQ(Ramp(Hold::kLinear).At(0, 9.0), 2.0);
}

TEST(CommandSignal, AverageIsTheIntegralOverTheInterval) {
  for (const Hold hold : {Hold::kZeroOrder, Hold::kLinear}) {
    const CommandSignal u = Ramp(hold);
    for (const auto& [begin, end] : {std::pair{-0.5, 0.3}, {0.2, 0.9}, {0.5, 3.7}, {3.0, 5.0}, {4.5, 5.5}}) {
      double sum = 0.0;
      constexpr int kPieces = 20000;
      for (int i = 0; i < kPieces; ++i) sum += u.At(0, begin + (end - begin) * (i + 0.5) / kPieces);
      EXPECT_NEAR(u.Average(0, begin, end), sum / kPieces, 2e-4) << begin << " " << end;
    }
  }
}

TEST(CommandSignal, RowsMayBeAsUnevenAsTheyLike) {
  // Bursts, a row that is late, and a gap as long as everything before it.
  std::vector<double> times;
  for (int k = 0; k < 40; ++k) times.push_back(0.01 * k + (k % 7 == 3 ? 0.004 : 0.0) + (k >= 30 ? 3.0 : 0.0));
  Eigen::MatrixXd u(1, 40);
  for (int k = 0; k < 40; ++k) u(0, k) = k;
  const CommandSignal signal = CommandSignal::Create(times, u, Hold::kZeroOrder).value();
  for (double t = -0.1; t < 3.6; t += 7e-4) {
    double row = 0;
    for (int k = 0; k < 40; ++k) row = times[k] <= t ? k : row;
    ASSERT_EQ(signal.At(0, t), row) << t;
  }
  for (int k = 0; k < 40; ++k) EXPECT_EQ(signal.At(0, times[k]), k);
}

TEST(CommandSignal, RefusesBadRowsByNumber) {
  Eigen::MatrixXd u = Eigen::MatrixXd::Zero(1, 3);
  EXPECT_FALSE(CommandSignal::Create({}, Eigen::MatrixXd(1, 0), Hold::kLinear).ok());
  const auto back = CommandSignal::Create({0, 1, 1}, u, Hold::kLinear);
  EXPECT_NE(back.status().message().find("row 2"), std::string::npos) << back.status().message();
  u(0, 1) = std::numeric_limits<double>::quiet_NaN();
  const auto nan = CommandSignal::Create({0, 1, 2}, u, Hold::kLinear);
  EXPECT_NE(nan.status().message().find("row 1"), std::string::npos) << nan.status().message();
}

}  // namespace
}  // namespace rg::sim
