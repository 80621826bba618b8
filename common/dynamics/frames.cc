// Poses, Jacobians and energies: what needs the kinematics of the bodies and little else.
#include <Eigen/Geometry>
#include <algorithm>

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

// By RobotModel's numbers of bodies.
BodyPoses ComputePoses(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q) {
  const Mechanism::Impl& m = mechanism.impl();
  RG_CHECK(q.size() == m.n()) << q.size();
  BodyPoses poses;
  void* scratch = Scratch(m, workspace.impl());
  if (m.plain) {
    m.kernels->poses(m.tree, q.data(), scratch, poses.data[0]);
    return poses;
  }
  BodyPoses placed;
  m.kernels->poses(m.tree, Unfolded(m.tree).Position(q).data(), scratch, placed.data[0]);
  for (int k = 0; k < m.tree.n; ++k) std::copy_n(placed.data[k], 12, poses.data[m.tree.body[k]]);
  return poses;
}

model::Pose PoseOf(const BodyPoses& poses, const model::Frame& frame) {
  if (frame.body < 0) return frame.X_BF;
  return model::Pose{poses.R(frame.body), poses.p(frame.body)} * frame.X_BF;
}

}  // namespace

model::Pose FramePose(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q,
                      const model::Frame& frame) {
  RG_CHECK(frame.body < mechanism.num_bodies()) << frame.body;
  return PoseOf(ComputePoses(mechanism, workspace, q), frame);
}

model::Pose FrameKinematics(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q,
                            const model::Frame& frame, MatrixOut J) {
  const Tree& tree = mechanism.impl().tree;
  RG_CHECK(frame.body < tree.n) << frame.body;
  RG_CHECK(J.rows() == 6 && J.cols() == tree.num_joints()) << J.rows() << "x" << J.cols();
  const BodyPoses poses = ComputePoses(mechanism, workspace, q);
  const model::Pose X_WF = PoseOf(poses, frame);
  J.setZero();
  for (int k = frame.body < 0 ? -1 : tree.place[frame.body]; k >= 0; k = tree.parent[k]) {
    const int body = tree.body[k];
    const Eigen::Vector3d axis = poses.R(body).col(2);
    Eigen::Matrix<double, 6, 1> motion = Eigen::Matrix<double, 6, 1>::Zero();
    motion.tail<3>() = axis;
    if (tree.revolute[k] != 0.0) {
      motion.head<3>() = axis;
      motion.tail<3>() = axis.cross(X_WF.translation - poses.p(body));
    }
    int joint = body;
    double ratio = 1.0;
    for (int i = 0; i < tree.num_ties; ++i) {
      if (tree.ties[i].follower == k) joint = tree.body[tree.ties[i].driver], ratio = tree.ties[i].ratio;
    }
    J.col(joint) += ratio * motion;
  }
  return X_WF;
}

double KineticEnergy(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q, const VectorIn& v) {
  const int n = mechanism.num_joints();
  RG_CHECK(q.size() == n && v.size() == n) << q.size() << " " << v.size();
  double data[kMaxBodies * kMaxBodies];
  Eigen::Map<Eigen::MatrixXd> M(data, n, n);
  Crba(mechanism, workspace, q, M);
  return 0.5 * v.dot(M.lazyProduct(v));
}

double PotentialEnergy(const Mechanism& mechanism, Workspace& workspace, const VectorIn& q) {
  const BodyPoses poses = ComputePoses(mechanism, workspace, q);
  const BodyParameters& phi = mechanism.body_parameters();
  double energy = 0.0;
  for (int k = 0; k < mechanism.num_bodies(); ++k) {
    const Eigen::Vector3d first_moment = poses.R(k) * phi.col(k).segment<3>(1) + phi(0, k) * poses.p(k);
    energy -= mechanism.gravity().dot(first_moment);
  }
  return energy;
}

}  // namespace rg::dynamics
