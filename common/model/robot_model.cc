#include "common/model/robot_model.h"

#include <utility>

#include "common/base/check.h"

namespace rg::model {
namespace {

template <class Field>
Eigen::VectorXd PerJoint(const std::vector<Joint>& joints, Field field) {
  Eigen::VectorXd out(joints.size());
  for (size_t k = 0; k < joints.size(); ++k) out[k] = joints[k].*field;
  return out;
}

template <class Item>
int FindByName(const std::vector<Item>& items, std::string_view name) {
  for (size_t i = 0; i < items.size(); ++i) {
    if (items[i].name == name) return static_cast<int>(i);
  }
  return -1;
}

}  // namespace

const std::array<std::string_view, kLinkParameters> kLinkParameterNames = {
    "mass",       "com_x",      "com_y",      "com_z",      "inertia_xx",
    "inertia_yy", "inertia_zz", "inertia_xy", "inertia_xz", "inertia_yz"};

Eigen::Matrix3d InertiaMatrix(const LinkParameters& link) {
  Eigen::Matrix3d inertia;
  inertia << link[4], link[7], link[8],  //
      link[7], link[5], link[9],         //
      link[8], link[9], link[6];
  return inertia;
}

std::string_view JointTypeName(JointType type) {
  switch (type) {
    case JointType::kRevolute:
      return "revolute";
    case JointType::kContinuous:
      return "continuous";
    case JointType::kPrismatic:
      return "prismatic";
  }
  return "unknown";
}

RobotModel::RobotModel(Parts parts) : parts_(std::move(parts)) {
  RG_CHECK(num_bodies() <= kMaxBodies) << num_bodies();
  RG_CHECK(parts_.end_effector >= 0 && parts_.end_effector < num_links());
  for (int k = 0; k < num_joints(); ++k) {
    RG_CHECK(joint(k).parent < k || joint(k).parent >= num_joints()) << joint(k).name;
  }
  for (const Follower& f : parts_.followers) {
    RG_CHECK(f.driver >= 0 && f.driver < num_joints() && f.multiplier != 0.0) << f.joint.name;
  }
  for (int b = 0; b < num_bodies(); ++b) {
    int steps = 0;
    for (int at = b; at >= 0; at = body_joint(at).parent) {
      RG_CHECK(at < num_bodies() && ++steps <= num_bodies()) << body_joint(b).name;
    }
  }
}

int RobotModel::FindJoint(std::string_view name) const { return FindByName(parts_.joints, name); }
int RobotModel::FindFollower(std::string_view name) const {
  for (size_t i = 0; i < parts_.followers.size(); ++i) {
    if (parts_.followers[i].joint.name == name) return static_cast<int>(i);
  }
  return -1;
}
int RobotModel::FindLink(std::string_view name) const { return FindByName(parts_.links, name); }

std::optional<Frame> RobotModel::FindFrame(std::string_view link_name) const {
  const int i = FindLink(link_name);
  if (i < 0) return std::nullopt;
  return Frame{link(i).body, link(i).X_BL};
}

Eigen::VectorXd RobotModel::LowerLimits() const { return PerJoint(parts_.joints, &Joint::lower); }
Eigen::VectorXd RobotModel::UpperLimits() const { return PerJoint(parts_.joints, &Joint::upper); }
Eigen::VectorXd RobotModel::EffortLimits() const { return PerJoint(parts_.joints, &Joint::effort); }
Eigen::VectorXd RobotModel::VelocityLimits() const { return PerJoint(parts_.joints, &Joint::velocity); }

Eigen::Matrix<double, kLinkParameters, Eigen::Dynamic> RobotModel::NominalLinkParameters() const {
  Eigen::Matrix<double, kLinkParameters, Eigen::Dynamic> out(kLinkParameters, num_links());
  for (int i = 0; i < num_links(); ++i) out.col(i) = link(i).parameters;
  return out;
}

}  // namespace rg::model
