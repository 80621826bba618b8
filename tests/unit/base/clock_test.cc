#include "common/base/clock.h"

#include <gtest/gtest.h>

namespace rg {
namespace {

TEST(Clock, WallTimeIsIso8601Utc) {
  EXPECT_EQ(FormatWallTime(1'767'225'600'123'000'000), "2026-01-01T00:00:00.123Z");
}

TEST(FakeClock, WallJumpsLeaveTheSteadyTimeAlone) {
  FakeClock clock;
  const int64_t steady = clock.SteadyNanos(), wall = clock.WallNanos();
  clock.JumpWall(-5);
  EXPECT_EQ(clock.SteadyNanos(), steady);
  EXPECT_EQ(clock.WallNanos(), wall - 5);
  clock.Advance(3);
  EXPECT_EQ(clock.SteadyNanos(), steady + 3);
}

}  // namespace
}  // namespace rg
