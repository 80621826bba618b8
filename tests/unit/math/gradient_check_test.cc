#include "common/math/gradient_check.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace rg::math {
namespace {

Eigen::VectorXd Curve(const Eigen::VectorXd& x) {
  return Eigen::Vector2d(std::sin(x[0]) * x[1], x[0] * x[0] + std::exp(x[1]));
}

Eigen::MatrixXd CurveJacobian(const Eigen::VectorXd& x) {
  Eigen::Matrix2d J;
  J << std::cos(x[0]) * x[1], std::sin(x[0]), 2.0 * x[0], std::exp(x[1]);
  return J;
}

const Eigen::VectorXd kPoint = Eigen::Vector2d(0.7, -0.4);

TEST(CheckGradient, AcceptsTheRightJacobian) {
  for (bool richardson : {false, true}) {
    const auto result = CheckGradient(Curve, kPoint, CurveJacobian(kPoint), {.richardson = richardson});
    EXPECT_TRUE(result) << result.message;
  }
}

TEST(CheckGradient, FindsTheOneWrongEntry) {
  Eigen::MatrixXd wrong = CurveJacobian(kPoint);
  wrong(1, 0) += 1e-5;
  const auto result = CheckGradient(Curve, kPoint, wrong);
  EXPECT_FALSE(result);
  EXPECT_EQ(result.row, 1);
  EXPECT_EQ(result.column, 0);
  EXPECT_NEAR(result.analytic - result.numeric, 1e-5, 1e-8);
}

TEST(CheckGradient, RejectsAJacobianThatIsTransposed) {
  EXPECT_FALSE(CheckGradient(Curve, kPoint, CurveJacobian(kPoint).transpose()));
}

TEST(CheckGradient, RejectsNaN) {
  Eigen::MatrixXd broken = CurveJacobian(kPoint);
  broken(0, 1) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(CheckGradient(Curve, kPoint, broken));
}

TEST(CheckGradient, RichardsonRemovesTheCubicError) {
  const auto quartic = [](const Eigen::VectorXd& x) {
    return Eigen::VectorXd::Constant(1, std::pow(x[0], 4) - x[0]);
  };
  const Eigen::VectorXd at = Eigen::VectorXd::Constant(1, 1.3);
  const Eigen::MatrixXd J = Eigen::MatrixXd::Constant(1, 1, 4.0 * std::pow(1.3, 3) - 1.0);
  EXPECT_LT(CheckGradient(quartic, at, J).worst_error, 1e-11);
}

}  // namespace
}  // namespace rg::math
