#include "common/model/joint_inertia.h"

#include <Eigen/Geometry>

namespace rg::model {
namespace {

using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

constexpr int kPoses = 3;
constexpr double kRounding = 1e-12;  // of a pivot, beside the size of the inertia behind the joint

// What moves one body: its joint, and the independent joint that drives it.
struct Mover {
  const Joint* joint;
  int driver;
  double multiplier, offset;
};

std::vector<Mover> MoversOf(const RobotModel::Parts& parts) {
  std::vector<Mover> movers;
  for (size_t k = 0; k < parts.joints.size(); ++k) {
    movers.push_back({&parts.joints[k], static_cast<int>(k), 1.0, 0.0});
  }
  for (const Follower& f : parts.followers) {
    movers.push_back({&f.joint, f.driver, f.multiplier, f.offset});
  }
  return movers;
}

// X_WB of body b, through its ancestors; there are few bodies.
Pose PoseOf(const std::vector<Mover>& movers, const VectorXd& q, int b) {
  const Mover& m = movers[b];
  const double angle = m.multiplier * q[m.driver] + m.offset;
  Pose motion;
  if (m.joint->is_revolute()) {
    motion.rotation = Eigen::AngleAxisd(angle, Vector3d::UnitZ()).toRotationMatrix();
  } else {
    motion.translation = angle * Vector3d::UnitZ();
  }
  const Pose X_PB = m.joint->X_PB * motion;
  return m.joint->parent < 0 ? X_PB : PoseOf(movers, q, m.joint->parent) * X_PB;
}

// M(q), and for each joint the size of the inertia that it moves: a mass, or moments about its origin.
struct Inertias {
  MatrixXd M;
  VectorXd size;
};

void AddLink(const Link& link, const std::vector<Mover>& movers, const std::vector<Pose>& X_WB,
             Inertias* out) {
  const int n = static_cast<int>(out->size.size());
  const Pose X_WL = X_WB[link.body] * link.X_BL;
  const double mass = link.parameters[0];
  const Vector3d com = X_WL.rotation * link.parameters.segment<3>(1) + X_WL.translation;
  const Eigen::Matrix3d I = X_WL.rotation * InertiaMatrix(link.parameters) * X_WL.rotation.transpose();
  MatrixXd angular = MatrixXd::Zero(3, n), linear = MatrixXd::Zero(3, n);
  for (int b = link.body; b >= 0; b = movers[b].joint->parent) {
    const Vector3d axis = X_WB[b].rotation.col(2), arm = com - X_WB[b].translation;
    const bool turns = movers[b].joint->is_revolute();
    const int k = movers[b].driver;
    if (turns) angular.col(k) += movers[b].multiplier * axis;
    linear.col(k) += movers[b].multiplier * (turns ? axis.cross(arm).eval() : axis);
    out->size[k] += turns ? I.trace() + mass * arm.squaredNorm() : mass;
  }
  out->M += mass * linear.transpose() * linear + angular.transpose() * I * angular;
}

Inertias InertiasAt(const RobotModel::Parts& parts, const std::vector<Mover>& movers, const VectorXd& q) {
  std::vector<Pose> X_WB;
  for (size_t b = 0; b < movers.size(); ++b) X_WB.push_back(PoseOf(movers, q, static_cast<int>(b)));
  Inertias out{MatrixXd::Zero(q.size(), q.size()), VectorXd::Zero(q.size())};
  for (const Link& link : parts.links) {
    if (link.body >= 0) AddLink(link, movers, X_WB, &out);
  }
  return out;
}

// Eliminates from the last joint to the first; a joint without a pivot is left out of the elimination,
// as one with any rotor inertia and a row of zeros would be.
std::vector<bool> HasPivot(Inertias inertias) {
  MatrixXd& M = inertias.M;
  const int n = static_cast<int>(M.rows());
  std::vector<bool> has(n, false);
  for (int k = n - 1; k >= 0; --k) {
    has[k] = M(k, k) > kRounding * inertias.size[k];
    if (has[k]) M.topLeftCorner(k, k) -= M.col(k).head(k) * M.row(k).head(k) / M(k, k);
  }
  return has;
}

}  // namespace

std::vector<int> JointsWithoutInertia(const RobotModel::Parts& parts) {
  const int n = static_cast<int>(parts.joints.size());
  const std::vector<Mover> movers = MoversOf(parts);
  std::vector<bool> found(n, false);
  for (int pose = 0; pose < kPoses; ++pose) {
    VectorXd q(n);
    for (int k = 0; k < n; ++k) q[k] = 0.37 + 0.61 * k + 1.13 * pose + 0.29 * k * pose;
    const std::vector<bool> has = HasPivot(InertiasAt(parts, movers, q));
    for (int k = 0; k < n; ++k) found[k] = found[k] || has[k];
  }
  std::vector<int> without;
  for (int k = 0; k < n; ++k) {
    if (!found[k]) without.push_back(k);
  }
  return without;
}

}  // namespace rg::model
