#include "common/model/inertial_parameters.h"

#include <Eigen/Eigenvalues>
#include <cmath>
#include <limits>

namespace rg::model {
namespace {

// L of the header: upper triangular, positive diagonal.
Eigen::Matrix3d Shape(const LogCholesky& theta) {
  Eigen::Matrix3d L;
  L << std::exp(theta[1]), theta[4], theta[6],  //
      0.0, std::exp(theta[2]), theta[5],        //
      0.0, 0.0, std::exp(theta[3]);
  return L;
}

// tr(S) 1 - S, which is its own kind of inverse: S = ½ tr(I) 1 - I.
Eigen::Matrix3d Inertia(const Eigen::Matrix3d& S) { return S.trace() * Eigen::Matrix3d::Identity() - S; }
Eigen::Matrix3d SecondMoment(const LinkParameters& link) {
  const Eigen::Matrix3d I = InertiaMatrix(link);
  return 0.5 * I.trace() * Eigen::Matrix3d::Identity() - I;
}

LinkParameters Pack(double mass, const Eigen::Vector3d& com, const Eigen::Matrix3d& I) {
  LinkParameters out;
  out << mass, com, I(0, 0), I(1, 1), I(2, 2), I(0, 1), I(0, 2), I(1, 2);
  return out;
}

}  // namespace

LinkParameters FromLogCholesky(const LogCholesky& theta) {
  const double mass = std::exp(2.0 * theta[0]);
  const Eigen::Matrix3d L = Shape(theta);
  return Pack(mass, theta.tail<3>(), Inertia(mass * L * L.transpose()));
}

Eigen::Matrix<double, 10, 10> LogCholeskyJacobian(const LogCholesky& theta) {
  const double mass = std::exp(2.0 * theta[0]);
  const Eigen::Matrix3d L = Shape(theta);
  const Eigen::Vector3d none = Eigen::Vector3d::Zero();
  Eigen::Matrix<double, 10, 10> J;
  J.col(0) = Pack(2.0 * mass, none, Inertia(2.0 * mass * L * L.transpose()));
  // dL has one entry: the diagonal (d1, d2, d3) or above it (s12, s23, s13).
  const int row[6] = {0, 1, 2, 0, 1, 0}, column[6] = {0, 1, 2, 1, 2, 2};
  for (int i = 0; i < 6; ++i) {
    Eigen::Matrix3d dL = Eigen::Matrix3d::Zero();
    dL(row[i], column[i]) = i < 3 ? L(row[i], column[i]) : 1.0;
    const Eigen::Matrix3d half = mass * dL * L.transpose();
    J.col(1 + i) = Pack(0.0, none, Inertia(half + half.transpose()));
  }
  for (int i = 0; i < 3; ++i) J.col(7 + i) = Pack(0.0, Eigen::Vector3d::Unit(i), Eigen::Matrix3d::Zero());
  return J;
}

std::optional<LogCholesky> ToLogCholesky(const LinkParameters& link) {
  if (!(ConsistencyMargin(link) > 0.0)) return std::nullopt;
  const Eigen::Matrix3d S = SecondMoment(link) / link[0];
  // S = L Lᵀ with L upper triangular: Cholesky from the last row upwards.
  const double l33 = std::sqrt(S(2, 2)), l23 = S(1, 2) / l33, l13 = S(0, 2) / l33;
  const double l22 = std::sqrt(S(1, 1) - l23 * l23), l12 = (S(0, 1) - l13 * l23) / l22;
  const double l11 = std::sqrt(S(0, 0) - l12 * l12 - l13 * l13);
  LogCholesky theta;
  theta << 0.5 * std::log(link[0]), std::log(l11), std::log(l22), std::log(l33), l12, l23, l13, link[1],
      link[2], link[3];
  if (!theta.allFinite()) return std::nullopt;  // consistent only to rounding
  return theta;
}

double ConsistencyMargin(const LinkParameters& link) {
  if (!(link[0] > 0.0)) return -std::numeric_limits<double>::infinity();
  return Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(SecondMoment(link) / link[0], Eigen::EigenvaluesOnly)
      .eigenvalues()[0];
}

}  // namespace rg::model
