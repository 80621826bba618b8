#include "common/recordings/velocity_lag.h"

#include <gtest/gtest.h>

#include <cmath>

#include "common/base/rng.h"
#include "common/recordings/noise.h"
#include "common/recordings/recording_set.h"

namespace rg::recordings {
namespace {

Recording Motion(double period, double lag, double position_noise, double velocity_noise) {
  Rng rng(7);
  Recording r;
  r.joints = {"a"};
  const int rows = static_cast<int>(8.0 / period);
  r.t.resize(rows), r.q.resize(1, rows), r.v.resize(1, rows);
  for (int k = 0; k < rows; ++k) {
    const double t = k * period, late = t - lag;
    r.t[k] = t;
    r.q(0, k) = 0.8 * std::sin(2 * t) + 0.2 * std::sin(7 * t + 1) + position_noise * rng.Normal();
    r.v(0, k) = 1.6 * std::cos(2 * late) + 1.4 * std::cos(7 * late + 1) + velocity_noise * rng.Normal();
  }
  return r;
}

TEST(VelocityLag, IsFoundWithinItsStddev) {
  for (const double lag : {0.004, 0.008, 0.02}) {
    const VelocityLag found = EstimateVelocityLag(Motion(0.001, lag, 1e-5, 1e-3));
    EXPECT_NEAR(found.lag[0], lag, 3e-4 + 3 * found.stddev[0]);
    EXPECT_GT(found.error[0], 0.0);
  }
}

TEST(VelocityLag, IsNotSeenWhereThereIsNone) {
  for (const double period : {0.002, 0.01, 0.04}) {
    const Recording r = Motion(period, 0.0, 5e-4, 5e-3);
    const VelocityLag found = EstimateVelocityLag(r);
    EXPECT_LT(std::abs(found.lag[0]), 3 * found.stddev[0] + 1e-3) << period;
    EXPECT_LT(found.error[0], 0.02) << period;  // of a speed of 1.5
  }
}

// A filter takes the white noise away; what it does to the velocity counts as noise.
TEST(VelocityLag, CountsAsNoiseOfTheVelocity) {
  RecordingSet set;
  set.joints = {"a"};
  set.recordings = {Motion(0.001, 0.008, 1e-5, 1e-5)};
  const SensorNoise noise = EstimateSensorNoise(set);
  const double acceleration = std::sqrt(0.5 * (3.2 * 3.2 + 9.8 * 9.8));  // RMS
  EXPECT_NEAR(noise.velocity_stddev[0], 0.008 * acceleration, 0.2 * 0.008 * acceleration);
}

}  // namespace
}  // namespace rg::recordings
