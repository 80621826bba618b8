// A robot of which some joints follow others, beside the same robot with all of them free.
#pragma once

#include <Eigen/Core>
#include <map>
#include <memory>
#include <vector>

#include "common/model/robot_model.h"

namespace rg::testing {

struct Binding {
  int driver = 0;  // joint of the free robot
  double ratio = 1.0, offset = 0.0;
};

// Joints of `free` by number: how each follows.
inline std::shared_ptr<const model::RobotModel> Bind(const model::RobotModel& free,
                                                     const std::map<int, Binding>& bindings) {
  std::vector<int> number(free.num_joints());
  int next = 0;
  for (int k = 0; k < free.num_joints(); ++k) {
    if (bindings.count(k) == 0) number[k] = next++;
  }
  for (const auto& [k, binding] : bindings) number[k] = next++;
  const auto renumbered = [&](int body) { return body < 0 ? -1 : number[body]; };
  model::RobotModel::Parts parts;
  parts.name = free.name();
  parts.links = free.links();
  parts.end_effector = free.FindLink(free.end_effector().name);
  for (model::Link& link : parts.links) link.body = renumbered(link.body);
  for (int k = 0; k < free.num_joints(); ++k) {
    model::Joint joint = free.joint(k);
    joint.parent = renumbered(joint.parent);
    if (bindings.count(k) == 0) parts.joints.push_back(joint);
  }
  for (const auto& [k, binding] : bindings) {
    model::Follower follower;
    follower.joint = free.joint(k);
    follower.joint.parent = renumbered(follower.joint.parent);
    follower.driver = number[binding.driver];
    follower.multiplier = binding.ratio, follower.offset = binding.offset;
    parts.followers.push_back(follower);
  }
  return std::make_shared<const model::RobotModel>(std::move(parts));
}

// q_free = G q + g0 of such a robot: n_free × n, n_free.
struct Unbound {
  Eigen::MatrixXd G;
  Eigen::VectorXd g0;
};
inline Unbound UnboundOf(const model::RobotModel& free, const std::map<int, Binding>& bindings) {
  Unbound out{Eigen::MatrixXd::Zero(free.num_joints(), free.num_joints() - static_cast<int>(bindings.size())),
              Eigen::VectorXd::Zero(free.num_joints())};
  int next = 0;
  for (int k = 0; k < free.num_joints(); ++k) {
    if (bindings.count(k) == 0) out.G(k, next++) = 1.0;
  }
  for (const auto& [k, binding] : bindings) {
    out.G.row(k) = binding.ratio * out.G.row(binding.driver);
    out.g0[k] = binding.offset;
  }
  return out;
}

}  // namespace rg::testing
