#include "common/model/urdf_loader.h"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <utility>

#include "common/base/file.h"
#include "common/base/number_text.h"
#include "common/model/joint_inertia.h"
#include "common/model/joint_motion.h"
#include "common/model/urdf_comparison.h"
#include "common/model/urdf_document.h"
#include "common/model/urdf_xml.h"

namespace rg::model {
namespace {

constexpr double kInf = std::numeric_limits<double>::infinity();

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

LinkParameters ToParameters(const UrdfInertial& inertial) {
  const Eigen::Matrix3d& R = inertial.origin.rotation;
  Eigen::Matrix3d about_com = inertial.inertia;
  if (!R.isIdentity(0.0)) about_com = (R * about_com * R.transpose()).eval();
  LinkParameters out;
  out << inertial.mass, inertial.origin.translation, about_com(0, 0), about_com(1, 1), about_com(2, 2),
      about_com(0, 1), about_com(0, 2), about_com(1, 2);
  return out;
}

constexpr double kManyTurns = 30.0,
                 kNoLimit = 1e4;   // rad; beyond the second, a URDF says that there is no limit
constexpr double kHeavy = 2000.0;  // kg

class Loader {
 public:
  Loader(const std::string& source, const LoadOptions& options, const UrdfDocument& document)
      : source_(source), options_(options), document_(document) {}

  Result<RobotModel> Run(const std::string& xml) {
    parts_.name = document_.robot_name;
    parts_.urdf_text = xml;
    parts_.locked = options_.locked;
    parts_.warnings = document_.warnings;
    RG_ASSIGN_OR_RETURN(motions_, MotionOfJoints(document_, source_, options_, &parts_.warnings));
    RG_RETURN_IF_ERROR(AddLinks());
    RG_RETURN_IF_ERROR(CheckFinite());
    SetDrivers();
    if (parts_.joints.empty()) return InvalidError(source_ + ": no joint is left to move");
    RG_RETURN_IF_ERROR(CheckMovingMass());
    parts_.joints_without_inertia = JointsWithoutInertia(parts_);
    CollectWarnings();
    RG_RETURN_IF_ERROR(ChooseEndEffector());
    return RobotModel(std::move(parts_));
  }

 private:
  using Kind = JointMotion::Kind;

  // A link's place: its pose in its body (in W for the base), and how many moving joints lie above it.
  struct Place {
    int link = -1;
    int body = -1;
    Pose X_BL;
    int depth = 0;
  };

  Status Error(const std::string& what) const { return InvalidError(source_ + ": " + what); }
  int NumMoving(Kind kind) const {
    return static_cast<int>(std::count_if(motions_.begin(), motions_.end(),
                                          [&](const JointMotion& m) { return m.kind == kind; }));
  }

  // Depth first, siblings in the order of the document.
  Status AddLinks() {
    parts_.links.resize(document_.links.size());
    depth_.resize(document_.links.size());
    num_joints_ = NumMoving(Kind::kMoves);
    struct ToAdd {
      int joint;
      Place parent;
    };
    std::vector<ToAdd> to_add;
    const auto add = [&](const Place& place) {
      AddLink(place);
      const std::vector<int>& below = document_.child_joints[place.link];
      for (auto j = below.rbegin(); j != below.rend(); ++j) to_add.push_back({*j, place});
    };
    add(Place{document_.root, -1, Pose{}, 0});
    while (!to_add.empty()) {
      const ToAdd next = to_add.back();
      to_add.pop_back();
      RG_ASSIGN_OR_RETURN(const Place child, AddJoint(next.joint, next.parent));
      add(child);
    }
    return Status::Ok();
  }

  void AddLink(const Place& place) {
    const UrdfLink& from = document_.links[place.link];
    Link& link = parts_.links[place.link];
    link.name = from.name;
    link.body = place.body;
    link.X_BL = place.X_BL;
    link.has_inertial = from.inertial.has_value();
    if (from.inertial) link.parameters = ToParameters(*from.inertial);
    depth_[place.link] = place.depth;
  }

  // The place of the joint's child link.
  Result<Place> AddJoint(int j, const Place& parent) {
    const UrdfJoint& from = document_.joints[j];
    const JointMotion& motion = motions_[j];
    const Pose X_BJ = parent.X_BL * from.origin;
    if (motion.kind == Kind::kStands) {
      return Place{from.child, parent.body, X_BJ * StandingMotion(from, motion.position), parent.depth};
    }
    if (parts_.joints.size() + parts_.followers.size() == kMaxBodies) {
      const bool mimics = NumMoving(Kind::kFollows) > 0;
      return Error("joint " + Quoted(from.name) + ": more than " + std::to_string(kMaxBodies) +
                   " moving joints" + (mimics ? ", mimic joints included" : "") + " (lock some)");
    }
    const Eigen::Matrix3d R_LB = AxisAlignment(from.axis);
    Joint joint;
    joint.name = from.name;
    joint.type = from.type;
    joint.parent = parent.body;
    joint.child_link = from.child;
    joint.axis = from.axis;
    joint.X_PB = X_BJ * Pose{R_LB, Eigen::Vector3d::Zero()};
    FillLimits(from, joint);
    const int body = Keep(j, std::move(joint));
    return Place{from.child, body, Pose{R_LB.transpose(), Eigen::Vector3d::Zero()}, parent.depth + 1};
  }

  // The number of the joint's body.
  int Keep(int j, Joint joint) {
    const JointMotion& motion = motions_[j];
    if (motion.kind == Kind::kMoves) {
      number_of_[j] = static_cast<int>(parts_.joints.size());
      parts_.joints.push_back(std::move(joint));
      return number_of_[j];
    }
    parts_.followers.push_back({std::move(joint), motion.driver, motion.multiplier, motion.offset});
    return num_joints_ + static_cast<int>(parts_.followers.size()) - 1;
  }

  // Followers may come before their drivers: from the document's numbers of joints to the model's.
  void SetDrivers() {
    for (Follower& follower : parts_.followers) follower.driver = number_of_.at(follower.driver);
  }

  static Pose StandingMotion(const UrdfJoint& joint, double q) {
    if (joint.is_fixed || q == 0.0) return Pose{};
    if (joint.type == JointType::kPrismatic) return {Eigen::Matrix3d::Identity(), joint.axis * q};
    return {Eigen::AngleAxisd(q, joint.axis).toRotationMatrix(), Eigen::Vector3d::Zero()};
  }

  static void FillLimits(const UrdfJoint& from, Joint& to) {
    const bool bounded = to.type != JointType::kContinuous;
    to.lower = bounded ? from.lower : -kInf;
    to.upper = bounded ? from.upper : kInf;
    to.effort = from.effort.value_or(kInf);
    to.velocity = from.velocity.value_or(kInf);
    to.damping = from.damping;
    to.friction = from.friction;
  }

  // Finite numbers may still add up to infinity.
  Status CheckFinite() const {
    for (const Link& link : parts_.links) {
      const bool finite =
          link.parameters.allFinite() && link.X_BL.rotation.allFinite() && link.X_BL.translation.allFinite();
      if (!finite) {
        return Error("link " + Quoted(link.name) + ": its place or its inertia is out of a double's range");
      }
    }
    for (const Joint& joint : parts_.joints) RG_RETURN_IF_ERROR(CheckFinite(joint));
    for (const Follower& follower : parts_.followers) RG_RETURN_IF_ERROR(CheckFinite(follower.joint));
    return Status::Ok();
  }
  Status CheckFinite(const Joint& joint) const {
    if (joint.X_PB.rotation.allFinite() && joint.X_PB.translation.allFinite()) return Status::Ok();
    return Error("joint " + Quoted(joint.name) + ": its place is out of a double's range");
  }

  Status CheckMovingMass() const {
    const bool any = std::any_of(parts_.links.begin(), parts_.links.end(),
                                 [](const Link& link) { return link.body >= 0 && link.parameters[0] > 0.0; });
    if (any) return Status::Ok();
    return Error(
        "nothing that moves has mass: no link that a joint moves has an <inertial> with mass above 0");
  }

  void CollectWarnings() {
    for (const Link& link : parts_.links) {
      if (link.has_inertial) WarnOfInertia(link);
    }
    for (const Joint& joint : parts_.joints) {
      const std::string label = source_ + ": joint " + Quoted(joint.name) + ": ";
      if (joint.effort == 0.0) parts_.warnings.push_back(label + "the effort limit is 0");
      if (joint.velocity == 0.0) parts_.warnings.push_back(label + "the velocity limit is 0");
      const double furthest = std::max(std::abs(joint.lower), std::abs(joint.upper));
      if (joint.type == JointType::kRevolute && furthest > kManyTurns && furthest < kNoLimit) {
        parts_.warnings.push_back(label + "limits " + NumberToText(joint.lower) + " to " +
                                  NumberToText(joint.upper) + " are many turns: URDF wants radians");
      }
      if (joint.lower == joint.upper) parts_.warnings.push_back(label + "lower and upper limit are equal");
    }
    for (const int k : parts_.joints_without_inertia) WarnOfMissingInertia(k);
  }

  void WarnOfInertia(const Link& link) {
    const Eigen::Vector3d moments =
        Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(InertiaMatrix(link.parameters), Eigen::EigenvaluesOnly)
            .eigenvalues();
    const double tolerance = 1e-9 * moments.cwiseAbs().maxCoeff();
    const std::string label = source_ + ": link " + Quoted(link.name) + ": ";
    if (moments[0] < -tolerance) {
      parts_.warnings.push_back(label + "the inertia has a negative principal moment");
    } else if (moments[0] + moments[1] < moments[2] - tolerance) {
      parts_.warnings.push_back(label + "the inertia breaks the triangle inequality (no body has it)");
    }
    if (link.parameters[0] > kHeavy) {
      parts_.warnings.push_back(label + "a mass of " + NumberToText(link.parameters[0]) +
                                " kg: URDF wants kg");
    }
    if (link.parameters[0] == 0.0 && moments.cwiseAbs().maxCoeff() > 0.0) {
      parts_.warnings.push_back(label + "has inertia but no mass");
    }
  }

  void WarnOfMissingInertia(int k) {
    const Joint& joint = parts_.joints[k];
    const bool has_mass = std::any_of(parts_.links.begin(), parts_.links.end(), [&](const Link& link) {
      return link.body == k && link.parameters[0] > 0.0;
    });
    const std::string what = has_mass ? "no inertia about its axis" : "no mass";
    parts_.warnings.push_back(source_ + ": joint " + Quoted(joint.name) + " moves link " +
                              Quoted(parts_.links[joint.child_link].name) + ", which has " + what +
                              ": simulating it needs its drive's rotor inertia");
  }

  Status ChooseEndEffector() {
    const int n = static_cast<int>(parts_.links.size());
    int& chosen = parts_.end_effector;
    for (int i = 0; i < n; ++i) {
      if (options_.end_effector.empty()) {
        if (!document_.child_joints[i].empty()) continue;
        if (chosen < 0 || depth_[i] > depth_[chosen]) chosen = i;
      } else if (parts_.links[i].name == options_.end_effector) {
        chosen = i;
      }
    }
    if (chosen >= 0) return Status::Ok();
    return Error("end effector link " + Quoted(options_.end_effector) + " does not exist");
  }

  const std::string& source_;
  const LoadOptions& options_;
  const UrdfDocument& document_;
  std::vector<JointMotion> motions_;
  RobotModel::Parts parts_;
  int num_joints_ = 0;            // n, known before the first is added
  std::map<int, int> number_of_;  // of the document's joints that move
  std::vector<int> depth_;
};

}  // namespace

Result<RobotModel> ParseUrdf(const std::string& xml, const std::string& source_name,
                             const LoadOptions& options) {
  RG_ASSIGN_OR_RETURN(const UrdfDocument document, ReadUrdfDocument(xml, source_name));
  RG_ASSIGN_OR_RETURN(RobotModel model, Loader(source_name, options, document).Run(xml));
  RG_RETURN_IF_ERROR(CompareWithDocument(model, source_name));
  return model;
}

Result<RobotModel> LoadUrdf(const std::string& path, const LoadOptions& options) {
  RG_ASSIGN_OR_RETURN(const std::string xml, ReadFile(path));
  return ParseUrdf(xml, path, options);
}

}  // namespace rg::model
