#include "robot_agent/drivers/kinova/clock_map.h"

#include <gtest/gtest.h>

#include "common/base/rng.h"

namespace rg::robot_agent::kinova {
namespace {

constexpr int64_t kMs = 1'000'000;
constexpr int64_t kAhead = 1'700'000'000'000'000'000;  // of the robot's clock

TEST(ClockMap, IsAsExactAsTheFastestMessageOfTheWindow) {
  ClockMap map(10.0);
  Rng random(7);
  int64_t worst = 0;
  for (int64_t k = 1; k < 2000; ++k) {
    const int64_t measured = k * 40 * kMs;
    const int64_t delay = kMs + static_cast<int64_t>(random.Uniform() * 30e6);
    const int64_t host = map.ToHost(measured + kAhead, measured + delay);
    if (k > 250) worst = std::max(worst, std::abs(host - measured));
  }
  EXPECT_LT(worst, 3 * kMs);
}

TEST(ClockMap, NeverGoesBackNorLiesAhead) {
  ClockMap map(10.0);
  Rng random(3);
  int64_t last = 0;
  for (int64_t k = 1; k < 500; ++k) {
    const int64_t received = k * 40 * kMs + static_cast<int64_t>(random.Uniform() * 39e6);
    const int64_t host = map.ToHost(k * 40 * kMs + kAhead, received);
    EXPECT_GT(host, last);
    EXPECT_LE(host, received);
    last = host;
  }
}

TEST(ClockMap, FollowsADriftingClock) {
  ClockMap map(10.0);
  int64_t worst = 0;
  for (int64_t k = 1; k < 5000; ++k) {
    const int64_t measured = k * 40 * kMs;
    const int64_t stamp = kAhead + measured + measured / 10'000;  // 100 ppm fast
    worst = std::max(worst, std::abs(map.ToHost(stamp, measured + kMs) - measured));
  }
  EXPECT_LT(worst, 3 * kMs);  // 100 ppm of the window, and the delay
}

TEST(ClockMap, StartsOverWhenTheRobotsClockIsSet) {
  ClockMap map(10.0);
  for (int64_t k = 1; k < 50; ++k) map.ToHost(k * 40 * kMs + kAhead, k * 40 * kMs);
  for (int64_t k = 50; k < 60; ++k) {
    const int64_t host = map.ToHost(k * 40 * kMs + kAhead - 3'600'000 * kMs, k * 40 * kMs);
    EXPECT_EQ(host, k * 40 * kMs);
  }
}

}  // namespace
}  // namespace rg::robot_agent::kinova
