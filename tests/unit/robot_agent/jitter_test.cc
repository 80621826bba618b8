#include "robot_agent/jitter.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

namespace rg::robot_agent {
namespace {

TEST(DurationHistogram, PercentilesAreUpperBoundsWithinAnEighth) {
  DurationHistogram h;
  for (int us = 1; us <= 10000; ++us) h.Add(us * 1000);
  for (const double p : {10.0, 50.0, 90.0, 99.0}) {
    EXPECT_GE(h.PercentileUs(p), p * 100);
    EXPECT_LE(h.PercentileUs(p), p * 100 * 1.126);
  }
  EXPECT_EQ(h.PercentileUs(100), 10000);
  EXPECT_EQ(h.max_us(), 10000);
  EXPECT_NEAR(h.mean_us(), 5000.5, 1e-9);
}

TEST(DurationHistogram, TakesNothingNegativeAndMinutes) {
  DurationHistogram h;
  h.Add(-5);
  h.Add(600'000'000'000);
  EXPECT_EQ(h.count(), 2u);
  EXPECT_EQ(h.max_us(), 6e8);
  EXPECT_LE(h.PercentileUs(50), 1.0);
}

TEST(JitterReport, TellsPercentilesAsJson) {
  JitterReport report;
  report.ticks = 3;
  report.lateness.Add(50'000);
  const auto json = nlohmann::json::parse(report.ToJson());
  EXPECT_EQ(json["ticks"], 3);
  EXPECT_EQ(json["lateness_us"]["max"], 50.0);
}

}  // namespace
}  // namespace rg::robot_agent
