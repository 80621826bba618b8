#include "common/math/so3.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace rg::math {
namespace {

// sin(x)/x, (1 - cos x)/x², (x - sin x)/x³ as functions of x²; series where the quotients cancel.
struct Coefficients {
  double a, b, c;
};

Coefficients At(double squared) {
  if (squared < 1e-3) {
    const double s = squared;
    return {1 - s / 6 * (1 - s / 20 * (1 - s / 42 * (1 - s / 72))),
            0.5 * (1 - s / 12 * (1 - s / 30 * (1 - s / 56))),
            1.0 / 6 * (1 - s / 20 * (1 - s / 42 * (1 - s / 72)))};
  }
  const double x = std::sqrt(squared);
  const double half = std::sin(0.5 * x);
  return {std::sin(x) / x, 2 * half * half / squared, (x - std::sin(x)) / (squared * x)};
}

}  // namespace

Eigen::Matrix3d Hat(const Eigen::Vector3d& a) {
  Eigen::Matrix3d out;
  out << 0, -a.z(), a.y(), a.z(), 0, -a.x(), -a.y(), a.x(), 0;
  return out;
}

Eigen::Vector3d Vee(const Eigen::Matrix3d& A) {
  return 0.5 * Eigen::Vector3d(A(2, 1) - A(1, 2), A(0, 2) - A(2, 0), A(1, 0) - A(0, 1));
}

Eigen::Matrix3d ExpSo3(const Eigen::Vector3d& w) {
  const Coefficients k = At(w.squaredNorm());
  const Eigen::Matrix3d W = Hat(w);
  return Eigen::Matrix3d::Identity() + k.a * W + k.b * W * W;
}

Eigen::Vector3d LogSo3(const Eigen::Matrix3d& R) {
  Eigen::Quaterniond quaternion(R);
  if (quaternion.w() < 0.0) quaternion.coeffs() *= -1.0;
  const double sine = quaternion.vec().norm();
  // 2 atan2(s, c) / s, which tends to 2 / c.
  const double scale = sine < 1e-9 ? 2.0 / quaternion.w() : 2.0 * std::atan2(sine, quaternion.w()) / sine;
  return scale * quaternion.vec();
}

Eigen::Matrix3d LeftJacobianSo3(const Eigen::Vector3d& w) {
  const Coefficients k = At(w.squaredNorm());
  const Eigen::Matrix3d W = Hat(w);
  return Eigen::Matrix3d::Identity() + k.b * W + k.c * W * W;
}

Eigen::Matrix3d LeftJacobianInverseSo3(const Eigen::Vector3d& w) {
  const double squared = w.squaredNorm();
  const Coefficients k = At(squared);
  // 1/x² - (1 + cos x) / (2 x sin x), written as (1 - a / (2 b)) / x².
  const double d =
      squared < 1e-3 ? 1.0 / 12 * (1 + squared / 60 * (1 + squared / 42)) : (1 - k.a / (2 * k.b)) / squared;
  const Eigen::Matrix3d W = Hat(w);
  return Eigen::Matrix3d::Identity() - 0.5 * W + d * W * W;
}

Eigen::Matrix3d FromRpy(const Eigen::Vector3d& rpy) {
  return (Eigen::AngleAxisd(rpy.z(), Eigen::Vector3d::UnitZ()) *
          Eigen::AngleAxisd(rpy.y(), Eigen::Vector3d::UnitY()) *
          Eigen::AngleAxisd(rpy.x(), Eigen::Vector3d::UnitX()))
      .toRotationMatrix();
}

Eigen::Vector3d ToRpy(const Eigen::Matrix3d& R) {
  const double cosine = std::hypot(R(0, 0), R(1, 0));
  const double pitch = std::atan2(-R(2, 0), cosine);
  if (cosine < 1e-12) return {0.0, pitch, std::atan2(-R(0, 1), R(1, 1))};
  return {std::atan2(R(2, 1), R(2, 2)), pitch, std::atan2(R(1, 0), R(0, 0))};
}

}  // namespace rg::math
