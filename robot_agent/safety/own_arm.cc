#include "robot_agent/safety/own_arm.h"

#include <limits>

#include "common/base/check.h"

namespace rg::robot_agent {

OwnArm::OwnArm(const model::RobotModel& model, const Eigen::Vector3d& gravity, const CapsuleSet& parts)
    : n_(model.num_joints()),
      tip_(*model.FindFrame(model.end_effector().name)),
      parts_(parts),
      from_now_(parts.capsules.size()),
      to_now_(parts.capsules.size()),
      mechanism_(model) {
  mechanism_.SetGravity(gravity);
  for (const Capsule& part : parts_.capsules) {
    const auto frame = model.FindFrame(part.link);
    RG_CHECK(frame.has_value()) << part.link;
    frames_.push_back(*frame);
  }
}

double OwnArm::Clearance(const double* q, int* pair) {
  const Eigen::Map<const Eigen::VectorXd> at(q, n_);
  for (size_t i = 0; i < frames_.size(); ++i) {
    const model::Pose pose = dynamics::FramePose(mechanism_, workspace_, at, frames_[i]);
    from_now_[i] = pose.rotation * parts_.capsules[i].from + pose.translation;
    to_now_[i] = pose.rotation * parts_.capsules[i].to + pose.translation;
  }
  double least = std::numeric_limits<double>::infinity();
  *pair = -1;
  for (size_t k = 0; k < parts_.apart.size(); ++k) {
    const auto a = static_cast<size_t>(parts_.apart[k].first),
               b = static_cast<size_t>(parts_.apart[k].second);
    const double distance = SegmentDistance(from_now_[a], to_now_[a], from_now_[b], to_now_[b]) -
                            parts_.capsules[a].radius - parts_.capsules[b].radius;
    if (distance >= least) continue;
    least = distance;
    *pair = static_cast<int>(k);
  }
  return least;
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
