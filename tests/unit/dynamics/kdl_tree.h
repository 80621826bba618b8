// A KDL tree from a URDF text, the way ROS' kdl_parser does it. Joints that the model does not move
// are fixed at 0.
#pragma once

#include <urdf_parser/urdf_parser.h>

#include <kdl/tree.hpp>

#include "common/model/robot_model.h"

namespace rg::dynamics {

inline KDL::Frame ToKdlFrame(const urdf::Pose& pose) {
  const urdf::Rotation& r = pose.rotation;
  return {KDL::Rotation::Quaternion(r.x, r.y, r.z, r.w), {pose.position.x, pose.position.y, pose.position.z}};
}

inline KDL::RigidBodyInertia ToKdlInertia(const urdf::InertialSharedPtr& inertial) {
  if (inertial == nullptr) return KDL::RigidBodyInertia(0.0);
  const KDL::Frame origin = ToKdlFrame(inertial->origin);
  const KDL::RotationalInertia about_com(inertial->ixx, inertial->iyy, inertial->izz, inertial->ixy,
                                         inertial->ixz, inertial->iyz);
  // Turned first, then set beside the origin: KDL's constructor takes the inertia about the com.
  const KDL::RotationalInertia turned =
      (origin.M * KDL::RigidBodyInertia(1.0, KDL::Vector::Zero(), about_com)).getRotationalInertia();
  return KDL::RigidBodyInertia(inertial->mass, origin.p, turned);
}

inline KDL::Joint ToKdlJoint(const urdf::Joint& joint, const model::RobotModel& model) {
  const KDL::Frame origin = ToKdlFrame(joint.parent_to_joint_origin_transform);
  if (model.FindJoint(joint.name) < 0) return KDL::Joint(joint.name, KDL::Joint::Fixed);
  const KDL::Vector axis = origin.M * KDL::Vector(joint.axis.x, joint.axis.y, joint.axis.z);
  const auto type = joint.type == urdf::Joint::PRISMATIC ? KDL::Joint::TransAxis : KDL::Joint::RotAxis;
  return KDL::Joint(joint.name, origin.p, axis, type);
}

inline void AddToKdlTree(const urdf::LinkConstSharedPtr& link, const model::RobotModel& model,
                         KDL::Tree& tree) {
  for (const auto& child : link->child_links) {
    const urdf::Joint& joint = *child->parent_joint;
    tree.addSegment(
        KDL::Segment(child->name, ToKdlJoint(joint, model),
                     ToKdlFrame(joint.parent_to_joint_origin_transform), ToKdlInertia(child->inertial)),
        link->name);
    AddToKdlTree(child, model, tree);
  }
}

inline KDL::Tree KdlTree(const model::RobotModel& model) {
  const auto urdf = urdf::parseURDF(model.urdf_text());
  KDL::Tree tree(urdf->getRoot()->name);
  AddToKdlTree(urdf->getRoot(), model, tree);
  return tree;
}

}  // namespace rg::dynamics
