#include "robot_agent/drivers/kinova/motion_watch.h"

#include <gtest/gtest.h>

namespace rg::robot_agent::kinova {
namespace {

MotionWatchOptions WatchOfTwo() {
  MotionWatchOptions options;
  options.joints = 2;
  options.strong_nm = {3.0, 1.5};
  return options;
}

// Whether it speaks within two seconds of 25 Hz.
template <class Q, class Torque>
bool Speaks(Q q, Torque torque) {
  MotionWatch watch(WatchOfTwo());
  for (int64_t k = 0; k < 50; ++k)
    if (watch.Step(k * 40'000'000, q(k), torque(k))) return true;
  return false;
}
const auto kStillArm = [](int64_t k) { return JointArray{1.0 + 1e-4 * (k % 2), 2.0}; };

TEST(MotionWatch, SeesAnArmThatIgnoresItsTorques) {
  EXPECT_TRUE(Speaks(kStillArm, [](int64_t) { return JointArray{0.0, 2.0}; }));
}

TEST(MotionWatch, IsSilentWhileTheArmMovesOrIsAskedForLittle) {
  EXPECT_FALSE(Speaks(
      [](int64_t k) {
        return JointArray{1.0, 2.0 + 0.001 * k};
      },
      [](int64_t) {
        return JointArray{0.0, 2.0};
      }));
  EXPECT_FALSE(Speaks(kStillArm, [](int64_t) { return JointArray{2.9, 1.4}; }));
}

TEST(MotionWatch, IsSilentWhenTheTorqueChangesItsSign) {
  EXPECT_FALSE(Speaks(kStillArm, [](int64_t k) { return JointArray{0.0, k % 4 < 2 ? 2.0 : -2.0}; }));
}

}  // namespace
}  // namespace rg::robot_agent::kinova
