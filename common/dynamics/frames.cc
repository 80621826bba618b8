// Poses, Jacobians and energies: what needs the kinematics of the bodies and little else.
#include <Eigen/Geometry>

#include "common/base/check.h"
#include "common/dynamics/dynamics.h"
#include "common/dynamics/mechanism_impl.h"

namespace rg::dynamics {
namespace {

struct BodyPoses {
  double data[kMaxBodies][12];

  Eigen::Map<const Eigen::Matrix3d> R(int k) const { return Eigen::Map<const Eigen::Matrix3d>(data[k]); }
  Eigen::Map<const Eigen::Vector3d> p(int k) const { return Eigen::Map<const Eigen::Vector3d>(data[k] + 9); }
};

BodyPoses ComputePoses(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q) {
  const Mechanism::Impl& m = mechanism.impl();
  RG_CHECK(q.size() == m.tree.n) << q.size();
  BodyPoses poses;
  m.kernels->poses(m.tree, q.data(), Scratch(m, workspace.impl()), poses.data[0]);
  return poses;
}

model::Pose PoseOf(const BodyPoses& poses, const model::Frame& frame) {
  if (frame.body < 0) return frame.X_BF;
  return model::Pose{poses.R(frame.body), poses.p(frame.body)} * frame.X_BF;
}

}  // namespace

model::Pose FramePose(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q,
                      const model::Frame& frame) {
  RG_CHECK(frame.body < mechanism.num_joints()) << frame.body;
  return PoseOf(ComputePoses(mechanism, workspace, q), frame);
}

model::Pose FrameKinematics(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q,
                            const model::Frame& frame, MatrixOut J) {
  const Tree& tree = mechanism.impl().tree;
  RG_CHECK(frame.body < tree.n) << frame.body;
  RG_CHECK(J.rows() == 6 && J.cols() == tree.n) << J.rows() << "x" << J.cols();
  const BodyPoses poses = ComputePoses(mechanism, workspace, q);
  const model::Pose X_WF = PoseOf(poses, frame);
  J.setZero();
  for (int j = frame.body; j >= 0; j = tree.parent[j]) {
    const Eigen::Vector3d axis = poses.R(j).col(2);
    if (tree.revolute[j] != 0.0) {
      J.col(j).head<3>() = axis;
      J.col(j).tail<3>() = axis.cross(X_WF.translation - poses.p(j));
    } else {
      J.col(j).tail<3>() = axis;
    }
  }
  return X_WF;
}

double KineticEnergy(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, const VectorIn& v) {
  const Mechanism::Impl& m = mechanism.impl();
  const int n = m.tree.n;
  RG_CHECK(q.size() == n && v.size() == n) << q.size() << " " << v.size();
  double M[kMaxBodies * kMaxBodies];
  m.kernels->crba(m.tree, m.inertias, q.data(), Scratch(m, workspace.impl()), M, n);
  return 0.5 * v.dot(Eigen::Map<const Eigen::MatrixXd>(M, n, n).lazyProduct(v));
}

double PotentialEnergy(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q) {
  const BodyPoses poses = ComputePoses(mechanism, workspace, q);
  const BodyParameters& phi = mechanism.body_parameters();
  double energy = 0.0;
  for (int k = 0; k < mechanism.num_joints(); ++k) {
    const Eigen::Vector3d first_moment = poses.R(k) * phi.col(k).segment<3>(1) + phi(0, k) * poses.p(k);
    energy -= mechanism.gravity().dot(first_moment);
  }
  return energy;
}

}  // namespace rg::dynamics
