#include "common/model/urdf_loader.h"

#include <console_bridge/console.h>
#include <urdf_parser/urdf_parser.h>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <mutex>
#include <utility>

#include "common/base/file.h"
#include "common/model/urdf_document.h"

namespace rg::model {
namespace {

constexpr double kInf = std::numeric_limits<double>::infinity();

// Keeps the last thing urdfdom says instead of printing it.
class CapturedLog : public console_bridge::OutputHandler {
 public:
  void log(const std::string& text, console_bridge::LogLevel level, const char*, int) override {
    if (level >= console_bridge::CONSOLE_BRIDGE_LOG_ERROR) text_ = text;
  }
  const std::string& text() const { return text_; }

 private:
  std::string text_;
};

Result<urdf::ModelInterfaceSharedPtr> ParseWithUrdfdom(const std::string& xml, const std::string& source) {
  static std::mutex mutex;  // console_bridge's handler is one per process
  std::lock_guard lock(mutex);
  CapturedLog captured;
  console_bridge::useOutputHandler(&captured);
  urdf::ModelInterfaceSharedPtr parsed;
  std::string thrown;
  try {
    parsed = urdf::parseURDF(xml);
  } catch (const std::exception& e) {
    thrown = e.what();
  }
  console_bridge::restorePreviousOutputHandler();
  if (parsed != nullptr) return parsed;
  const std::string& reason = thrown.empty() ? captured.text() : thrown;
  return InvalidError(source + ": urdfdom: " + (reason.empty() ? "cannot parse the document" : reason));
}

Pose ToPose(const urdf::Pose& pose) {
  const urdf::Rotation& r = pose.rotation;
  const Eigen::Quaterniond quaternion = Eigen::Quaterniond(r.w, r.x, r.y, r.z).normalized();
  return {quaternion.toRotationMatrix(), {pose.position.x, pose.position.y, pose.position.z}};
}

// Constant rotation R_LB of the body frame whose z is the joint's axis: identity for 0 0 1, else the
// smallest turn that takes z to the axis (half a turn about x for 0 0 -1).
Eigen::Matrix3d AxisAlignment(const Eigen::Vector3d& axis) {
  const double z = axis.z();
  if (z > 1.0 - 1e-15) return Eigen::Matrix3d::Identity();
  if (z < -1.0 + 1e-12) return Eigen::Vector3d(1.0, -1.0, -1.0).asDiagonal();
  const Eigen::Vector3d cross = Eigen::Vector3d::UnitZ().cross(axis);
  Eigen::Matrix3d hat;
  hat << 0, -cross.z(), cross.y(), cross.z(), 0, -cross.x(), -cross.y(), cross.x(), 0;
  return Eigen::Matrix3d::Identity() + hat + hat * hat / (1.0 + z);
}

LinkParameters ToParameters(const urdf::Inertial& inertial) {
  const Pose origin = ToPose(inertial.origin);
  Eigen::Matrix3d about_com;
  about_com << inertial.ixx, inertial.ixy, inertial.ixz,  //
      inertial.ixy, inertial.iyy, inertial.iyz,           //
      inertial.ixz, inertial.iyz, inertial.izz;
  if (!origin.rotation.isIdentity(0.0)) {
    about_com = (origin.rotation * about_com * origin.rotation.transpose()).eval();
  }
  LinkParameters out;
  out << inertial.mass, origin.translation, about_com(0, 0), about_com(1, 1), about_com(2, 2),
      about_com(0, 1), about_com(0, 2), about_com(1, 2);
  return out;
}

bool CanMove(const urdf::Joint& joint) { return joint.type != urdf::Joint::FIXED; }

class Loader {
 public:
  Loader(const std::string& source, const LoadOptions& options, const UrdfOutline& outline,
         const urdf::ModelInterface& urdf)
      : source_(source), options_(options), outline_(outline), urdf_(urdf) {}

  Result<RobotModel> Run(const std::string& xml) {
    RG_RETURN_IF_ERROR(CheckOptions());
    parts_.name = outline_.robot_name;
    parts_.urdf_text = xml;
    parts_.locked = options_.locked;
    parts_.links.resize(outline_.links.size());
    RG_RETURN_IF_ERROR(AddLink(urdf_.getRoot()->name, -1, Pose{}, 0));
    if (parts_.joints.empty()) return InvalidError(source_ + ": no joint is left to move");
    RG_RETURN_IF_ERROR(CheckMovingInertia());
    CollectWarnings();
    RG_RETURN_IF_ERROR(ChooseEndEffector());
    return RobotModel(std::move(parts_));
  }

 private:
  Status Error(const std::string& what) const { return InvalidError(source_ + ": " + what); }

  Status CheckOptions() const {
    for (const std::string& name : options_.joints) {
      const auto joint = urdf_.getJoint(name);
      if (joint == nullptr) return Error("joint '" + name + "' does not exist");
      if (!CanMove(*joint)) return Error("joint '" + name + "' is fixed and cannot move");
      if (options_.locked.contains(name)) return Error("joint '" + name + "' is both moving and locked");
      if (std::count(options_.joints.begin(), options_.joints.end(), name) > 1) {
        return Error("joint '" + name + "' is asked for twice");
      }
    }
    for (const auto& [name, q] : options_.locked) {
      const auto joint = urdf_.getJoint(name);
      if (joint == nullptr) return Error("locked joint '" + name + "' does not exist");
      if (!CanMove(*joint) && q != 0.0) return Error("locked joint '" + name + "' is fixed");
      if (!std::isfinite(q)) return Error("locked joint '" + name + "': position is not finite");
    }
    return Status::Ok();
  }

  bool Moves(const urdf::Joint& joint) const {
    if (!CanMove(joint) || options_.locked.contains(joint.name)) return false;
    return options_.joints.empty() ||
           std::find(options_.joints.begin(), options_.joints.end(), joint.name) != options_.joints.end();
  }

  // Joints below a link, in the order of the document.
  std::vector<urdf::JointSharedPtr> ChildJoints(const std::string& link) const {
    std::vector<urdf::JointSharedPtr> out;
    for (const std::string& name : outline_.joints) {
      const auto joint = urdf_.joints_.at(name);
      if (joint->parent_link_name == link) out.push_back(joint);
    }
    return out;
  }

  int LinkIndex(const std::string& name) const {
    return static_cast<int>(std::find(outline_.links.begin(), outline_.links.end(), name) -
                            outline_.links.begin());
  }

  // `X_BL`: the link's pose in body `body` (W for the base); `depth`: moving joints above it.
  Status AddLink(const std::string& name, int body, const Pose& X_BL, int depth) {
    const int index = LinkIndex(name);
    Link& link = parts_.links[index];
    link.name = name;
    link.body = body;
    link.X_BL = X_BL;
    const auto urdf_link = urdf_.getLink(name);
    if (urdf_link->inertial != nullptr) {
      link.has_inertial = true;
      link.parameters = ToParameters(*urdf_link->inertial);
    }
    depth_.resize(parts_.links.size());
    depth_[index] = depth;
    for (const auto& joint : ChildJoints(name)) RG_RETURN_IF_ERROR(AddJoint(*joint, body, X_BL, depth));
    return Status::Ok();
  }

  Status AddJoint(const urdf::Joint& urdf_joint, int parent_body, const Pose& X_BL, int depth) {
    const Pose X_BJ = X_BL * ToPose(urdf_joint.parent_to_joint_origin_transform);
    const Eigen::Vector3d axis =
        Eigen::Vector3d(urdf_joint.axis.x, urdf_joint.axis.y, urdf_joint.axis.z).normalized();
    if (!Moves(urdf_joint)) {
      return AddLink(urdf_joint.child_link_name, parent_body, X_BJ * LockedMotion(urdf_joint, axis), depth);
    }
    if (urdf_joint.mimic != nullptr) {
      return Error("joint '" + urdf_joint.name + "': mimics joint '" + urdf_joint.mimic->joint_name +
                   "', which is not supported (lock it, or choose the joints that move)");
    }
    if (parts_.joints.size() == kMaxBodies) {
      return Error("joint '" + urdf_joint.name + "': more than " + std::to_string(kMaxBodies) +
                   " moving joints (lock some)");
    }
    const Eigen::Matrix3d R_LB = AxisAlignment(axis);
    Joint joint;
    joint.name = urdf_joint.name;
    joint.type = urdf_joint.type == urdf::Joint::PRISMATIC    ? JointType::kPrismatic
                 : urdf_joint.type == urdf::Joint::CONTINUOUS ? JointType::kContinuous
                                                              : JointType::kRevolute;
    joint.parent = parent_body;
    joint.child_link = LinkIndex(urdf_joint.child_link_name);
    joint.axis = axis;
    joint.X_PB = X_BJ * Pose{R_LB, Eigen::Vector3d::Zero()};
    FillLimits(urdf_joint, joint);
    parts_.joints.push_back(joint);
    const int body = static_cast<int>(parts_.joints.size()) - 1;
    return AddLink(urdf_joint.child_link_name, body, Pose{R_LB.transpose(), Eigen::Vector3d::Zero()},
                   depth + 1);
  }

  Pose LockedMotion(const urdf::Joint& joint, const Eigen::Vector3d& axis) const {
    const auto it = options_.locked.find(joint.name);
    if (it == options_.locked.end() || it->second == 0.0) return Pose{};
    if (joint.type == urdf::Joint::PRISMATIC) return {Eigen::Matrix3d::Identity(), axis * it->second};
    return {Eigen::AngleAxisd(it->second, axis).toRotationMatrix(), Eigen::Vector3d::Zero()};
  }

  static void FillLimits(const urdf::Joint& from, Joint& to) {
    const bool bounded = to.type != JointType::kContinuous;
    const bool has = from.limits != nullptr;
    to.lower = bounded ? from.limits->lower : -kInf;
    to.upper = bounded ? from.limits->upper : kInf;
    to.effort = has ? from.limits->effort : kInf;
    to.velocity = has ? from.limits->velocity : kInf;
    to.damping = from.dynamics != nullptr ? from.dynamics->damping : 0.0;
    to.friction = from.dynamics != nullptr ? from.dynamics->friction : 0.0;
  }

  // Inertia of a body's own links about its joint's axis (revolute) or mass (prismatic); for a body
  // with children, whether anything behind it has mass.
  Status CheckMovingInertia() const {
    const int n = static_cast<int>(parts_.joints.size());
    std::vector<double> mass(n, 0.0), about_axis(n, 0.0);
    std::vector<bool> leaf(n, true);
    for (const Link& link : parts_.links) {
      if (link.body < 0) continue;
      const Eigen::Vector3d com = link.X_BL.rotation * link.parameters.segment<3>(1) + link.X_BL.translation;
      const Eigen::Matrix3d I =
          link.X_BL.rotation * InertiaMatrix(link.parameters) * link.X_BL.rotation.transpose();
      mass[link.body] += link.parameters[0];
      about_axis[link.body] += I(2, 2) + link.parameters[0] * com.head<2>().squaredNorm();
    }
    for (int k = n - 1; k >= 0; --k) {
      const Joint& joint = parts_.joints[k];
      const std::string moved = "joint '" + joint.name + "' moves ";
      if (mass[k] <= 0.0) {
        return Error(moved + "nothing that has mass: link '" + parts_.links[joint.child_link].name +
                     "' and what hangs on it have no <inertial> with mass above 0");
      }
      if (leaf[k] && joint.is_revolute() && about_axis[k] <= 0.0) {
        return Error(moved + "link '" + parts_.links[joint.child_link].name +
                     "', which has no inertia about its axis");
      }
      if (joint.parent >= 0) {
        mass[joint.parent] += mass[k];
        leaf[joint.parent] = false;
      }
    }
    return Status::Ok();
  }

  void CollectWarnings() {
    for (const Link& link : parts_.links) {
      if (!link.has_inertial) continue;
      const Eigen::Vector3d moments = Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(
                                          InertiaMatrix(link.parameters), Eigen::EigenvaluesOnly)
                                          .eigenvalues();
      const double tolerance = 1e-9 * moments.cwiseAbs().maxCoeff();
      const std::string label = source_ + ": link '" + link.name + "': ";
      if (moments[0] < -tolerance) {
        parts_.warnings.push_back(label + "the inertia has a negative principal moment");
      } else if (moments[0] + moments[1] < moments[2] - tolerance) {
        parts_.warnings.push_back(label + "the inertia breaks the triangle inequality (no body has it)");
      }
      if (link.parameters[0] == 0.0 && moments.cwiseAbs().maxCoeff() > 0.0) {
        parts_.warnings.push_back(label + "has inertia but no mass");
      }
    }
    for (const Joint& joint : parts_.joints) {
      const std::string label = source_ + ": joint '" + joint.name + "': ";
      if (joint.effort == 0.0) parts_.warnings.push_back(label + "the effort limit is 0");
      if (joint.velocity == 0.0) parts_.warnings.push_back(label + "the velocity limit is 0");
      if (joint.lower == joint.upper) parts_.warnings.push_back(label + "lower and upper limit are equal");
    }
  }

  Status ChooseEndEffector() {
    if (!options_.end_effector.empty()) {
      const int index = LinkIndex(options_.end_effector);
      if (index == static_cast<int>(outline_.links.size())) {
        return Error("end effector link '" + options_.end_effector + "' does not exist");
      }
      parts_.end_effector = index;
      return Status::Ok();
    }
    int best = -1;
    for (int i = 0; i < static_cast<int>(outline_.links.size()); ++i) {
      if (!ChildJoints(outline_.links[i]).empty()) continue;
      if (best < 0 || depth_[i] > depth_[best]) best = i;
    }
    parts_.end_effector = best;
    return Status::Ok();
  }

  const std::string& source_;
  const LoadOptions& options_;
  const UrdfOutline& outline_;
  const urdf::ModelInterface& urdf_;
  RobotModel::Parts parts_;
  std::vector<int> depth_;
};

}  // namespace

Result<RobotModel> ParseUrdf(const std::string& xml, const std::string& source_name,
                             const LoadOptions& options) {
  RG_ASSIGN_OR_RETURN(const UrdfOutline outline, CheckUrdfDocument(xml, source_name));
  RG_ASSIGN_OR_RETURN(const urdf::ModelInterfaceSharedPtr urdf, ParseWithUrdfdom(xml, source_name));
  return Loader(source_name, options, outline, *urdf).Run(xml);
}

Result<RobotModel> LoadUrdf(const std::string& path, const LoadOptions& options) {
  RG_ASSIGN_OR_RETURN(const std::string xml, ReadFile(path));
  return ParseUrdf(xml, path, options);
}

}  // namespace rg::model
