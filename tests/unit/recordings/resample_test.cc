#include "common/recordings/resample.h"

#include <gtest/gtest.h>

namespace rg::recordings {
namespace {

Recording Ramp() {
  Recording r;
  r.joints = {"a"};
  r.t = Eigen::Vector4d(1.0, 2.0, 3.0, 5.0);
  r.q = Eigen::RowVector4d(10.0, 20.0, 30.0, 50.0);
  r.v = Eigen::RowVector4d(10.0, 10.0, 10.0, 10.0);
  r.effort_command = Eigen::RowVector4d(1.0, 2.0, 3.0, 4.0);
  r.effort_measured = Eigen::RowVector4d(1.0, 2.0, 3.0, 4.0);
  return r;
}

TEST(RowAt, HoldsARowUntilTheNextOneStarts) {
  const Recording r = Ramp();
  EXPECT_EQ(RowAt(r.t, 0.0), 0);
  EXPECT_EQ(RowAt(r.t, 1.999), 0);
  EXPECT_EQ(RowAt(r.t, 2.0), 1);
  EXPECT_EQ(RowAt(r.t, 4.9), 2);
  EXPECT_EQ(RowAt(r.t, 9.0), 3);
}

TEST(Resample, InterpolatesWhatIsMeasuredAndHoldsWhatIsCommanded) {
  const Recording r = Resample(Ramp(), Eigen::Vector3d(1.5, 3.0, 4.0));
  EXPECT_EQ(r.q, Eigen::RowVector3d(15.0, 30.0, 40.0));
  EXPECT_EQ(r.effort_measured, Eigen::RowVector3d(1.5, 3.0, 3.5));
  EXPECT_EQ(r.effort_command, Eigen::RowVector3d(1.0, 3.0, 3.0));
}

TEST(ResampleAtRate, ReproducesALinearMotionThroughAGap) {
  const Recording r = ResampleAtRate(Ramp(), 10.0);
  ASSERT_EQ(r.rows(), 41);
  for (int k = 0; k < r.rows(); ++k) EXPECT_NEAR(r.q(0, k), 10.0 * r.t[k], 1e-12);
}

TEST(InterpolateLinear, IsConstantOutsideTheRecording) {
  const Recording r = Ramp();
  const Eigen::MatrixXd q = InterpolateLinear(r.t, r.q, Eigen::Vector2d(-1.0, 8.0));
  EXPECT_EQ(q, Eigen::RowVector2d(10.0, 50.0));
}

}  // namespace
}  // namespace rg::recordings
