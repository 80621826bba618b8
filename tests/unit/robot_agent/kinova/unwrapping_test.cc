#include "robot_agent/drivers/kinova/unwrapping.h"

#include <gtest/gtest.h>

#include <cmath>

namespace rg::robot_agent::kinova {
namespace {

double Unwrapped(Unwrapper& unwrapper, double degrees) {
  return ToDegrees(unwrapper.Unwrap(ToRadians(Degrees{degrees}))).value;
}

TEST(Unwrapper, TakesTheFirstAngleToTheBranchOfTheReference) {
  Unwrapper near_zero(true, Radians{0.0});
  EXPECT_NEAR(Unwrapped(near_zero, 440.8), 80.8, 1e-9);
  EXPECT_EQ(near_zero.turns(), 1);
  Unwrapper near_half(true, ToRadians(Degrees{180}));
  EXPECT_NEAR(Unwrapped(near_half, -170), 190, 1e-9);
}

TEST(Unwrapper, FollowsAWayOfSeveralTurns) {
  Unwrapper unwrapper(true, Radians{0.0});
  for (double angle = 0.0; angle < 1000.0; angle += 20.0)
    EXPECT_NEAR(Unwrapped(unwrapper, angle), angle, 1e-9);
}

TEST(Unwrapper, TakesBackAJumpOfAWholeTurn) {
  Unwrapper unwrapper(true, Radians{0.0});
  Unwrapped(unwrapper, 355.0 - 360.0);
  EXPECT_NEAR(Unwrapped(unwrapper, 356.0), -4.0, 1e-9);  // the arm counts anew after its restart
  EXPECT_NEAR(Unwrapped(unwrapper, 358.0), -2.0, 1e-9);
  EXPECT_NEAR(Unwrapped(unwrapper, 1.0), 1.0, 1e-9);
}

TEST(Unwrapper, AsksTheArmForTheNearAngleNotForATurn) {
  Unwrapper unwrapper(true, Radians{0.0});
  Unwrapped(unwrapper, 377.0);
  EXPECT_NEAR(ToDegrees(unwrapper.Raw(ToRadians(Degrees{5.0}))).value, 365.0, 1e-9);
}

TEST(Unwrapper, LeavesJointsWithStopsAndNanAlone) {
  Unwrapper stopped(false, Radians{0.0});
  EXPECT_DOUBLE_EQ(Unwrapped(stopped, 300.0), 300.0);
  Unwrapper turning(true, Radians{0.0});
  EXPECT_TRUE(std::isnan(Unwrapped(turning, std::nan(""))));
  EXPECT_NEAR(Unwrapped(turning, 361.0), 1.0, 1e-9);
}

}  // namespace
}  // namespace rg::robot_agent::kinova
