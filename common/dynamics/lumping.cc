// Link parameters (mass, com, inertia about the com; link axes) to body parameters (barycentric).
#include <Eigen/Geometry>

#include "common/base/check.h"
#include "common/dynamics/dynamics.h"

namespace rg::dynamics {
namespace {

using Matrix10 = Eigen::Matrix<double, 10, 10>;
using Vector10 = Eigen::Matrix<double, 10, 1>;

// φ from mass, first moment and inertia about the origin.
Vector10 Barycentric(double mass, const Eigen::Vector3d& first, const Eigen::Matrix3d& I) {
  Vector10 phi;
  phi << mass, first, I(0, 0), I(0, 1), I(0, 2), I(1, 1), I(1, 2), I(2, 2);
  return phi;
}

// c·c 1 - c cᵀ, so that m times it is the inertia of a point mass about the origin.
Eigen::Matrix3d PointInertia(const Eigen::Vector3d& c) {
  return c.squaredNorm() * Eigen::Matrix3d::Identity() - c * c.transpose();
}

// d PointInertia(c) in direction e.
Eigen::Matrix3d PointInertiaDerivative(const Eigen::Vector3d& c, const Eigen::Vector3d& e) {
  return 2.0 * c.dot(e) * Eigen::Matrix3d::Identity() - c * e.transpose() - e * c.transpose();
}

Vector10 LinkInBody(const model::Pose& X_BL, const model::LinkParameters& link) {
  const double m = link[0];
  const Eigen::Vector3d c = X_BL.rotation * link.segment<3>(1) + X_BL.translation;
  const Eigen::Matrix3d about_com = X_BL.rotation * model::InertiaMatrix(link) * X_BL.rotation.transpose();
  return Barycentric(m, m * c, about_com + m * PointInertia(c));
}

}  // namespace

BodyParameters LumpedInertias(const model::RobotModel& model, const LinkParametersMatrix& links) {
  RG_CHECK(links.cols() == model.num_links())
      << links.cols() << " columns for " << model.num_links() << " links";
  BodyParameters out = BodyParameters::Zero(kBodyParameters, model.num_bodies());
  for (int i = 0; i < model.num_links(); ++i) {
    const model::Link& link = model.link(i);
    if (link.body >= 0) out.col(link.body) += LinkInBody(link.X_BL, links.col(i));
  }
  return out;
}

Matrix10 LumpingJacobian(const model::RobotModel& model, int link, const model::LinkParameters& parameters) {
  RG_CHECK(link >= 0 && link < model.num_links()) << link;
  const model::Pose& X_BL = model.link(link).X_BL;
  const double m = parameters[0];
  const Eigen::Vector3d c = X_BL.rotation * parameters.segment<3>(1) + X_BL.translation;
  Matrix10 J;
  J.col(0) = Barycentric(1.0, c, PointInertia(c));
  for (int i = 0; i < 3; ++i) {
    const Eigen::Vector3d e = X_BL.rotation.col(i);
    J.col(1 + i) = Barycentric(0.0, m * e, m * PointInertiaDerivative(c, e));
  }
  for (int i = 4; i < 10; ++i) {
    const Eigen::Matrix3d unit = model::InertiaMatrix(model::LinkParameters::Unit(i));
    J.col(i) = Barycentric(0.0, Eigen::Vector3d::Zero(), X_BL.rotation * unit * X_BL.rotation.transpose());
  }
  return J;
}

}  // namespace rg::dynamics
