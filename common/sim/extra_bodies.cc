#include <utility>

#include "common/sim/plant_data.h"

namespace rg::sim::internal {
namespace {

// Rotation whose z axis is the given axis of the parent (0 x, 1 y, 2 z).
Eigen::Matrix3d AxisToZ(int axis) {
  Eigen::Matrix3d R;
  R.col(2) = Eigen::Vector3d::Unit(axis);
  R.col(0) = Eigen::Vector3d::Unit((axis + 1) % 3);
  R.col(1) = Eigen::Vector3d::Unit((axis + 2) % 3);
  return R;
}

model::Joint ExtraJoint(std::string name, model::JointType type, int parent, const model::Pose& placement) {
  model::Joint joint;
  joint.name = std::move(name);
  joint.type = type;
  joint.parent = parent;
  joint.axis = Eigen::Vector3d::UnitZ();
  joint.X_PB = placement;
  return joint;
}

constexpr const char* kAxisNames[] = {"x", "y", "z"};

// Two joints at W's origin carry everything, the base's own links included.
void AddFlexibleBase(model::RobotModel::Parts& parts) {
  std::vector<model::Joint> joints;
  model::Pose base;  // of the last extra body in W
  for (int axis = 0; axis < kBaseJoints; ++axis) {
    const model::Pose target{AxisToZ(axis), Eigen::Vector3d::Zero()};
    joints.push_back(ExtraJoint(std::string("base_tilt_") + kAxisNames[axis], model::JointType::kRevolute,
                                axis - 1, base.Inverse() * target));
    base = target;
  }
  const model::Pose from_base = base.Inverse();
  const auto onto_base = [&](model::Joint* joint) {
    if (joint->parent < 0) joint->X_PB = from_base * joint->X_PB;
    joint->parent += kBaseJoints;  // the base, -1, becomes the last of the two
  };
  for (model::Joint joint : parts.joints) {
    onto_base(&joint);
    joints.push_back(std::move(joint));
  }
  for (model::Follower& follower : parts.followers) {
    onto_base(&follower.joint);
    follower.driver += kBaseJoints;
  }
  for (model::Link& link : parts.links) {
    if (link.body < 0) link.X_BL = from_base * link.X_BL;
    link.body += kBaseJoints;
  }
  parts.joints = std::move(joints);
}

// Numbers for `count` more joints behind those there are: those of the followers' bodies grow.
void MakeRoom(model::RobotModel::Parts& parts, int count) {
  const int n = static_cast<int>(parts.joints.size());
  const auto shift = [&](int* body) {
    if (*body >= n) *body += count;
  };
  for (model::Joint& joint : parts.joints) shift(&joint.parent);
  for (model::Follower& follower : parts.followers) shift(&follower.joint.parent);
  for (model::Link& link : parts.links) shift(&link.body);
}

// `count` joints at the tool's origin, along or about its axes from the first one on; the last one carries
// the mass, a link of its own in the tool's axes.
void AddMovingMass(model::RobotModel::Parts& parts, int tool_link, model::JointType type, const char* name,
                   int first, int count) {
  MakeRoom(parts, count);
  const model::Link& tool = parts.links[tool_link];
  model::Pose placement = tool.X_BL;  // of the tool's frame in the parent body
  int parent = tool.body;
  model::Pose orientation;  // of the present body in the tool's axes
  for (int i = 0; i < count; ++i) {
    const int axis = (first + i) % 3;
    const model::Pose target{AxisToZ(axis), Eigen::Vector3d::Zero()};
    parts.joints.push_back(ExtraJoint(std::string(name) + kAxisNames[axis], type, parent,
                                      i == 0 ? placement * target : orientation.Inverse() * target));
    orientation = target;
    parent = static_cast<int>(parts.joints.size()) - 1;
  }
  model::Link mass;
  mass.name = "sloshing_mass";
  mass.has_inertial = true;
  mass.body = parent;
  mass.X_BL = orientation.Inverse();
  parts.joints.back().child_link = static_cast<int>(parts.links.size());
  parts.links.push_back(mass);
}

}  // namespace

std::shared_ptr<const model::RobotModel> WithExtraBodies(std::shared_ptr<const model::RobotModel> model,
                                                         const ExtraBodies& extra, int tool) {
  const bool rod = extra.rod_hinge >= 0;
  if (!extra.flexible_base && !extra.mass_in_springs && !rod) return model;
  model::RobotModel::Parts parts;
  parts.name = model->name();
  parts.urdf_text = model->urdf_text();
  parts.joints = model->joints();
  parts.followers = model->followers();
  parts.links = model->links();
  parts.end_effector = model->FindLink(model->end_effector().name);
  if (extra.flexible_base) AddFlexibleBase(parts);
  if (extra.mass_in_springs)
    AddMovingMass(parts, tool, model::JointType::kPrismatic, "slosh_", 0, kSloshJoints);
  if (rod) AddMovingMass(parts, tool, model::JointType::kRevolute, "swing_", extra.rod_hinge, kRodJoints);
  return std::make_shared<const model::RobotModel>(std::move(parts));
}

}  // namespace rg::sim::internal
