#include "robot_agent/drivers/kinova/units.h"

#include <gtest/gtest.h>

#include <type_traits>

namespace rg::robot_agent::kinova {
namespace {

TEST(Units, DegreesAndRadiansConvertOnlyByName) {
  EXPECT_DOUBLE_EQ(ToRadians(Degrees{180.0}).value, kPi);
  EXPECT_DOUBLE_EQ(ToDegrees(Radians{-kPi / 2}).value, -90.0);
  EXPECT_FALSE((std::is_convertible_v<Degrees, Radians>));
  EXPECT_FALSE((std::is_convertible_v<double, Radians>));
}

}  // namespace
}  // namespace rg::robot_agent::kinova
