#include "common/recordings/velocity_column.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "common/base/rng.h"

namespace rg::recordings {
namespace {

Recording Moving(double noise, double velocity_step) {
  Rng rng(5);
  Recording r;
  r.joints = {"a", "b"};
  const int rows = 1000;
  r.t = Eigen::VectorXd::LinSpaced(rows, 0, 9.99);
  r.q.resize(2, rows);
  r.v.resize(2, rows);
  for (int k = 0; k < rows; ++k) {
    for (int j = 0; j < 2; ++j) {
      const double w = 1.0 + j, t = r.t[k];
      r.q(j, k) = 0.6 * std::sin(w * t) + noise * rng.Normal();
      r.v(j, k) = 0.6 * w * std::cos(w * t);
      if (velocity_step > 0) r.v(j, k) = velocity_step * std::round(r.v(j, k) / velocity_step);
    }
  }
  return r;
}

TEST(FrozenVelocity, ZeroThroughoutIsLeftOutWithANote) {
  Recording r = Moving(5e-4, 0);
  r.v.row(1).setZero();
  LeaveOutFrozenVelocity(&r);
  EXPECT_FALSE(r.has_velocity());
  ASSERT_EQ(r.notes.size(), 1u);
  EXPECT_THAT(r.notes[0], ::testing::HasSubstr("velocity.b is 0 throughout while its position moves"));
}

TEST(FrozenVelocity, AColumnThatStopsIsSeen) {
  Recording r = Moving(5e-4, 0);
  r.v.row(0).tail(400).setConstant(r.v(0, 599));
  LeaveOutFrozenVelocity(&r);
  EXPECT_FALSE(r.has_velocity());
  EXPECT_THAT(r.notes.at(0), ::testing::HasSubstr("velocity.a stands still for"));
}

TEST(FrozenVelocity, CoarseStepsNoiseAndRestAreKept) {
  for (const double noise : {0.0, 5e-4, 5e-3}) {
    for (const double step : {0.0, 0.02, 0.1}) {
      Recording r = Moving(noise, step);
      LeaveOutFrozenVelocity(&r);
      EXPECT_TRUE(r.has_velocity()) << noise << " " << step;
    }
  }
  Recording rest = Moving(5e-4, 0);
  rest.q.row(1).setConstant(0.3);
  rest.v.row(1).setZero();
  LeaveOutFrozenVelocity(&rest);
  EXPECT_TRUE(rest.has_velocity()) << "a joint that does not move";
}

}  // namespace
}  // namespace rg::recordings
