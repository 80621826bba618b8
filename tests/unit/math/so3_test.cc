#include "common/math/so3.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

#include "common/base/rng.h"
#include "common/math/gradient_check.h"

namespace rg::math {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

Vector3d RandomDirection(Rng& rng) { return Vector3d(rng.Normal(), rng.Normal(), rng.Normal()).normalized(); }

TEST(So3, ExpIsARotationAndLogUndoesIt) {
  Rng rng(1);
  for (double angle : {0.0, 1e-12, 1e-6, 1e-2, 0.0316, 0.5, 2.0, 3.1, 3.14159}) {
    const Vector3d w = angle * RandomDirection(rng);
    const Matrix3d R = ExpSo3(w);
    EXPECT_NEAR((R * R.transpose() - Matrix3d::Identity()).norm(), 0.0, 1e-14);
    EXPECT_NEAR((R - Eigen::AngleAxisd(angle, w.normalized()).toRotationMatrix()).norm(), 0.0,
                angle == 0 ? 1 : 1e-14);
    EXPECT_NEAR((LogSo3(R) - w).norm(), 0.0, 1e-13 * std::max(1.0, angle)) << angle;
  }
}

TEST(So3, LogOfHalfATurnIsHalfATurn) {
  Rng rng(2);
  for (int i = 0; i < 20; ++i) {
    const Vector3d axis = RandomDirection(rng);
    const Vector3d w = LogSo3(ExpSo3(M_PI * axis));
    EXPECT_NEAR(w.norm(), M_PI, 1e-9);
    EXPECT_NEAR(std::abs(w.normalized().dot(axis)), 1.0, 1e-12);
  }
}

TEST(So3, LeftJacobianIsTheDerivativeOfExp) {
  Rng rng(3);
  for (double angle : {0.0, 1e-4, 0.03, 0.04, 1.0, 3.0}) {
    const Vector3d w = angle * RandomDirection(rng);
    const auto relative = [&](const Eigen::VectorXd& dw) {
      return Eigen::VectorXd(LogSo3(ExpSo3(w + Vector3d(dw)) * ExpSo3(w).transpose()));
    };
    const auto check = CheckGradient(relative, Vector3d::Zero(), LeftJacobianSo3(w), {.tolerance = 1e-9});
    EXPECT_TRUE(check) << angle << ": " << check.message;
    EXPECT_NEAR((LeftJacobianSo3(w) * LeftJacobianInverseSo3(w) - Matrix3d::Identity()).norm(), 0.0, 1e-12);
  }
}

TEST(So3, HatIsTheCrossProductAndVeeUndoesIt) {
  const Vector3d a(1, -2, 0.5), b(0.3, 4, -1);
  EXPECT_EQ(Hat(a) * b, a.cross(b));
  EXPECT_EQ(Vee(Hat(a)), a);
}

TEST(So3, RpyRoundTripsAwayFromTheSingularPitch) {
  Rng rng(4);
  for (int i = 0; i < 50; ++i) {
    const Vector3d rpy(rng.Uniform(-3, 3), rng.Uniform(-1.5, 1.5), rng.Uniform(-3, 3));
    EXPECT_NEAR((ToRpy(FromRpy(rpy)) - rpy).norm(), 0.0, 1e-12);
  }
  const Matrix3d up = FromRpy({0.4, M_PI / 2, 0.9});
  EXPECT_NEAR((FromRpy(ToRpy(up)) - up).norm(), 0.0, 1e-9);
}

}  // namespace
}  // namespace rg::math
