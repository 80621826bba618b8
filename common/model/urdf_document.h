// A URDF text as data: what the document says, element by element, with its own numbers. Internal to
// the loader, and for those who want a URDF's names before they load it.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "common/model/robot_model.h"

namespace rg::model {

struct UrdfInertial {
  Pose origin;              // of the inertial frame in the link's frame; its translation is the com [m]
  double mass = 0.0;        // [kg] ≥ 0
  Eigen::Matrix3d inertia;  // [kg·m²] about the com, axes of the inertial frame
};

struct UrdfLink {
  std::string name;
  std::optional<UrdfInertial> inertial;
};

struct UrdfMimic {
  std::string driver;  // the joint it names, which may be missing or a mimic itself
  double multiplier = 1.0;
  double offset = 0.0;
};

struct UrdfJoint {
  std::string name;
  bool is_fixed = false;
  JointType type = JointType::kRevolute;  // of a joint that is not fixed, like all that follows origin
  int parent = -1;                        // indices into links
  int child = -1;
  Pose origin;                           // of the joint's (and child's) frame in the parent link's
  Eigen::Vector3d axis{1.0, 0.0, 0.0};   // unit vector in the joint's frame
  double lower = 0.0;                    // [rad or m]; 0 where the document has none
  double upper = 0.0;                    //
  std::optional<double> effort;          // [N·m or N]
  std::optional<double> velocity;        // [rad/s or m/s]
  double damping = 0.0, friction = 0.0;  // 0 where the document has none
  std::optional<UrdfMimic> mimic;
};

struct UrdfDocument {
  std::string robot_name;
  std::vector<UrdfLink> links;  // in the order of the document, like the joints
  std::vector<UrdfJoint> joints;
  int root = -1;                               // the link without a parent
  std::vector<std::vector<int>> child_joints;  // per link, in the order of the document
  std::vector<std::string> warnings;           // what is not read (urdf_leftovers.h) or doubtful

  std::vector<std::string> JointNames() const;
};

// Refuses, naming `source_name`, the element and the value: what ParseUrdfXml refuses; names that are
// missing or used twice; joints of other types than revolute, continuous, prismatic and fixed, between
// links that do not exist or that do not make one tree; numbers that are none or not finite; negative
// masses, moments and limits; an axis without direction; limits that are missing or the wrong way round;
// elements that are there twice.
Result<UrdfDocument> ReadUrdfDocument(const std::string& xml, const std::string& source_name);

}  // namespace rg::model
