#include "services/sysid/fit_space.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <cmath>
#include <string>
#include <utility>

#include "common/model/robot_model.h"

namespace rg::sysid {
namespace {

using Eigen::Matrix3d;
using Eigen::Matrix4d;
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;
using Vector10 = Eigen::Matrix<double, 10, 1>;

// Prior stddev of ξ, and the lengths by which a URDF may be wrong whatever the link's size.
constexpr double kMassPrior = 0.125;                   // of α: 25 % of the mass
constexpr double kComPrior = 0.3, kComLength = 0.005;  // of the spread; m
constexpr double kShapePrior = 0.25, kShapeLength = 0.01;
constexpr double kBound = 6.0, kLargestPrior = 0.5;  // ξ within kBound · min(prior stddev, kLargestPrior)

Matrix3d Symmetric(const Eigen::Matrix<double, 6, 1>& i) {  // xx yy zz xy xz yz
  Matrix3d m;
  m << i[0], i[3], i[4], i[3], i[1], i[5], i[4], i[5], i[2];
  return m;
}

// Central second moment of mass from the inertia about the com, lifted to a body that can exist.
Matrix3d CentralMoment(double mass, const Matrix3d& inertia) {
  const Matrix3d moment = 0.5 * inertia.trace() * Matrix3d::Identity() - inertia;
  const Eigen::SelfAdjointEigenSolver<Matrix3d> eigen(moment);
  const Vector3d lifted = eigen.eigenvalues().cwiseMax(mass * kMinSpread * kMinSpread);
  return eigen.eigenvectors() * lifted.asDiagonal() * eigen.eigenvectors().transpose();
}

// Upper triangular U with P = U Uᵀ.
Matrix4d UpperCholesky(const Matrix4d& P) {
  const Matrix4d flipped = P.reverse();  // J P J with J the exchange matrix
  const Matrix4d L = flipped.llt().matrixL();
  return L.reverse();
}

// U of the pseudo-inertia of a link, or of the nearest body.
Matrix4d Factor(const Vector10& p) {
  const Vector3d com = p.segment<3>(1);
  Matrix4d P;
  P.topLeftCorner<3, 3>() = CentralMoment(p[0], Symmetric(p.tail<6>())) + p[0] * com * com.transpose();
  P.topRightCorner<3, 1>() = p[0] * com;
  P.bottomLeftCorner<1, 3>() = p[0] * com.transpose();
  P(3, 3) = p[0];
  return UpperCholesky(P);
}

Matrix4d Transform(const Vector10& xi) {
  Matrix4d T = Matrix4d::Identity();
  for (int i = 0; i < 3; ++i) {
    T(i, 3) = xi[1 + i];
    T(i, i) = std::exp(xi[4 + i]);
  }
  T(0, 1) = xi[7];
  T(0, 2) = xi[8];
  T(1, 2) = xi[9];
  return std::exp(xi[0]) * T;
}

// ξ of a transform.
Vector10 CoordinatesOf(Matrix4d T) {
  Vector10 xi;
  xi[0] = std::log(T(3, 3));
  T /= T(3, 3);
  xi.segment<3>(1) = T.topRightCorner<3, 1>();
  xi.segment<3>(4) = T.diagonal().head<3>().array().log();
  xi.tail<3>() << T(0, 1), T(0, 2), T(1, 2);
  return xi;
}

// dT/dξ_k at ξ.
Matrix4d TransformDerivative(const Vector10& xi, int k) {
  if (k == 0) return Transform(xi);
  Matrix4d d = Matrix4d::Zero();
  if (k <= 3) {
    d(k - 1, 3) = 1.0;
  } else if (k <= 6) {
    d(k - 4, k - 4) = std::exp(xi[k]);
  } else {
    d(k == 9 ? 1 : 0, k == 7 ? 1 : 2) = 1.0;
  }
  return std::exp(xi[0]) * d;
}

// (m, c, I about c) of a pseudo-inertia.
Vector10 FromPseudoInertia(const Matrix4d& P) {
  Vector10 p;
  const double m = P(3, 3);
  const Vector3d c = P.topRightCorner<3, 1>() / m;
  const Matrix3d moment = P.topLeftCorner<3, 3>() - m * c * c.transpose();
  const Matrix3d I = moment.trace() * Matrix3d::Identity() - moment;
  p << m, c, I(0, 0), I(1, 1), I(2, 2), I(0, 1), I(0, 2), I(1, 2);
  return p;
}

// Its derivative along dP.
Vector10 FromPseudoInertia(const Matrix4d& P, const Matrix4d& dP) {
  const double m = P(3, 3), dm = dP(3, 3);
  const Vector3d c = P.topRightCorner<3, 1>() / m;
  const Vector3d dc = (dP.topRightCorner<3, 1>() - c * dm) / m;
  const Matrix3d outer = m * dc * c.transpose();
  const Matrix3d moment = dP.topLeftCorner<3, 3>() - dm * c * c.transpose() - outer - outer.transpose();
  const Matrix3d I = moment.trace() * Matrix3d::Identity() - moment;
  Vector10 p;
  p << dm, dc, I(0, 0), I(1, 1), I(2, 2), I(0, 1), I(0, 2), I(1, 2);
  return p;
}

// Ten parameters from `first` on are all of one link, in the order of kLinkParameterNames.
bool IsWholeLink(const std::vector<FitParameter>& parameters, size_t first) {
  if (first + model::kLinkParameters > parameters.size()) return false;
  const std::string& head = parameters[first].name;
  const size_t dot = head.find('.');
  if (dot == std::string::npos || head.substr(0, dot) != "mass") return false;
  const std::string link = head.substr(dot);
  for (int k = 0; k < model::kLinkParameters; ++k) {
    if (parameters[first + k].name != std::string(model::kLinkParameterNames[k]) + link) return false;
  }
  return parameters[first].nominal > 0.0;
}

}  // namespace

std::string_view ParametrisationName(bool consistent) { return consistent ? "log-cholesky" : "raw"; }

Result<bool> ParseParametrisation(std::string_view name) {
  if (name == "log-cholesky") return true;
  if (name == "raw") return false;
  return InvalidError("parametrisation '" + std::string(name) + "' is neither raw nor log-cholesky");
}

FitSpace::FitSpace(std::vector<FitParameter> parameters, bool consistent)
    : parameters_(std::move(parameters)) {
  const int P = size();
  for (VectorXd* v : {&nominal_, &lower_, &upper_, &prior_stddev_}) v->resize(P);
  for (int i = 0; i < P; ++i) {
    nominal_[i] = parameters_[i].nominal;
    lower_[i] = parameters_[i].lower;
    upper_[i] = parameters_[i].upper;
    prior_stddev_[i] = parameters_[i].prior_stddev;
  }
  for (int i = 0; consistent && i < P; ++i) {
    if (!IsWholeLink(parameters_, i)) continue;
    Vector10 p;
    for (int k = 0; k < 10; ++k) p[k] = parameters_[i + k].nominal;
    const LinkBlock block{i, Factor(p)};
    nominal_.segment<10>(i).setZero();
    const Vector3d spread = block.U0.diagonal().head<3>() / std::sqrt(p[0]);
    prior_stddev_[i] = kMassPrior;
    for (int k = 0; k < 3; ++k) {
      prior_stddev_[i + 1 + k] = std::hypot(kComPrior, kComLength / spread[k]);
      prior_stddev_[i + 4 + k] = std::hypot(kShapePrior, kShapeLength / spread[k]);
    }
    prior_stddev_[i + 7] = std::hypot(kShapePrior, kShapeLength / spread[0]);
    prior_stddev_[i + 8] = prior_stddev_[i + 7];
    prior_stddev_[i + 9] = std::hypot(kShapePrior, kShapeLength / spread[1]);
    lower_.segment<10>(i) = -kBound * prior_stddev_.segment<10>(i).cwiseMin(kLargestPrior);
    upper_.segment<10>(i) = -lower_.segment<10>(i);
    links_.push_back(block);
    i += 9;
  }
}

VectorXd FitSpace::From(const VectorXd& values) const {
  VectorXd theta = nominal_;
  for (int i = 0; i < size(); ++i) {
    if (IsItself(i)) theta[i] = values[parameters_[i].index];
  }
  return theta.cwiseMax(lower_).cwiseMin(upper_);
}

VectorXd FitSpace::At(const VectorXd& values) const {
  VectorXd theta(size());
  for (int i = 0; i < size(); ++i) theta[i] = values[parameters_[i].index];
  for (const LinkBlock& link : links_) {
    auto p = theta.segment<10>(link.first);
    if (p[0] > 0.0) {
      p = CoordinatesOf(link.U0.triangularView<Eigen::Upper>().solve(Factor(p)));
    } else {
      p.setZero();
    }
  }
  return theta;
}

FitSpace FitSpace::With(const LeastSquaresProblem& problem) const {
  FitSpace out = *this;
  out.nominal_ = problem.initial;
  out.lower_ = problem.lower;
  out.upper_ = problem.upper;
  out.prior_stddev_ = problem.scale;
  return out;
}

FitSpace::Coordinate FitSpace::CoordinateOf(int i) const {
  for (const LinkBlock& link : links_) {
    const int k = i - link.first;
    if (k < 0 || k >= 10) continue;
    return k == 0   ? Coordinate::kMass
           : k <= 3 ? Coordinate::kCentre
           : k <= 6 ? Coordinate::kStretch
                    : Coordinate::kShear;
  }
  return Coordinate::kItself;
}

VectorXd FitSpace::Parameters(const VectorXd& theta) const {
  VectorXd p = theta;
  for (const LinkBlock& link : links_) {
    const Matrix4d U = link.U0 * Transform(theta.segment<10>(link.first));
    p.segment<10>(link.first) = FromPseudoInertia(U * U.transpose());
  }
  return p;
}

VectorXd FitSpace::Values(const VectorXd& theta, VectorXd values) const {
  const VectorXd p = Parameters(theta);
  for (int i = 0; i < size(); ++i) values[parameters_[i].index] = p[i];
  return values;
}

FitSpace::Block FitSpace::BlockJacobian(int link, const VectorXd& theta) const {
  const LinkBlock& block = links_[link];
  const Vector10 xi = theta.segment<10>(block.first);
  const Matrix4d U = block.U0 * Transform(xi);
  const Matrix4d P = U * U.transpose();
  Block J;
  for (int k = 0; k < 10; ++k) {
    const Matrix4d half = block.U0 * TransformDerivative(xi, k) * U.transpose();
    J.col(k) = FromPseudoInertia(P, half + half.transpose());
  }
  return J;
}

MatrixXd FitSpace::Jacobian(const VectorXd& theta) const {
  MatrixXd J = MatrixXd::Identity(size(), size());
  for (size_t l = 0; l < links_.size(); ++l) {
    J.block<10, 10>(links_[l].first, links_[l].first) = BlockJacobian(static_cast<int>(l), theta);
  }
  return J;
}

void FitSpace::PullBack(const VectorXd& theta, RowMatrix* J) const {
  for (size_t l = 0; l < links_.size(); ++l) {
    const Block block = BlockJacobian(static_cast<int>(l), theta);
    J->middleCols<10>(links_[l].first) = (J->middleCols<10>(links_[l].first) * block).eval();
  }
}

}  // namespace rg::sysid
