#include "robot_agent/safety/own_arm.h"

namespace rg::robot_agent {

OwnArm::OwnArm(const model::RobotModel& model, const Eigen::Vector3d& gravity)
    : n_(model.num_joints()), tip_(*model.FindFrame(model.end_effector().name)), mechanism_(model) {
  mechanism_.SetGravity(gravity);
}

void OwnArm::GravityTorque(const double* q, double* tau) {
  Eigen::Map<Eigen::VectorXd> out(tau, n_);
  dynamics::GravityTorque(mechanism_, workspace_, Eigen::Map<const Eigen::VectorXd>(q, n_), out);
}

void OwnArm::Tip(const double* q, double* position) {
  const model::Pose pose =
      dynamics::FramePose(mechanism_, workspace_, Eigen::Map<const Eigen::VectorXd>(q, n_), tip_);
  Eigen::Map<Eigen::Vector3d>{position} = pose.translation;
}

}  // namespace rg::robot_agent
