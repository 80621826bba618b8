#include "robot_agent/drivers/kinova/rate_estimate.h"

#include <gtest/gtest.h>

namespace rg::robot_agent::kinova {
namespace {

TEST(RateEstimate, IsTheMeanOfTheLastIntervals) {
  RateEstimate rate;
  EXPECT_EQ(rate.hz(), 0.0);
  rate.Note(1'000'000'000);
  EXPECT_EQ(rate.intervals(), 0);
  for (int k = 1; k <= 200; ++k) rate.Note(1'000'000'000 + k * 40'000'000ll + (k % 2) * 10'000'000ll);
  EXPECT_EQ(rate.intervals(), RateEstimate::kMost);
  EXPECT_NEAR(rate.hz(), 25.0, 0.2);
  rate.Restart();
  EXPECT_EQ(rate.intervals(), 0);
}

}  // namespace
}  // namespace rg::robot_agent::kinova
