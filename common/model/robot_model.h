// A robot as a tree of moving bodies, with every URDF link kept apart for identification.
//
// Bodies and joints. The n movable, unlocked joints are numbered 0 … n-1 in topological order (a
// parent before its children; siblings in the order of the document). Joint k moves body k. A link
// that hangs on a fixed or locked joint is lumped into the moving body it is attached to, or into
// the base (body -1); it keeps its own ten inertial parameters.
//
// Mimic joints. A joint that mimics a moving one has no freedom of its own: it is one of the m
// followers, q = multiplier · q_driver + offset, and moves a body of its own. Bodies 0 … n-1 are moved by
// joints(), bodies n … n+m-1 by followers(). A mimic whose driver stands is a locked joint.
//
// Frames. W is the frame of the URDF's root link, which does not move. The frame of body k has its
// origin on joint k and its z axis along joint k's axis, so the joint's motion is a rotation about, or
// a translation along, +z. Where the URDF's axis is 0 0 1 this is the child link's own frame; else it
// is that frame turned by a constant rotation (Link::X_BL holds it).
//   X_WB(k) = X_WB(parent) · Joint::X_PB · (Rz(q) or Tz(q))
// Parents come before their children within joints() and within followers(); a joint may hang on the
// body of a follower (parent >= n) and a follower on any body.
//
// Immutable after loading; shared freely between threads.
#pragma once

#include <Eigen/Core>
#include <array>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace rg::model {

// More moving bodies than this are refused at load: kernels hold their workspace in fixed arrays.
inline constexpr int kMaxBodies = 16;

// Rigid transform X_AB: p_A = rotation · p_B + translation.
struct Pose {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();  // R_AB
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();   // p_AB, origin of B in A [m]

  Pose operator*(const Pose& other) const {
    return {rotation * other.rotation, rotation * other.translation + translation};
  }
  Pose Inverse() const { return {rotation.transpose(), -(rotation.transpose() * translation)}; }
};

// The ten inertial parameters of a link, as a URDF gives them, all in the link's frame L:
//   0      mass [kg]
//   1..3   com x, y, z [m], position of the centre of mass
//   4..9   inertia xx, yy, zz, xy, xz, yz [kg·m²] about the centre of mass, axes of L
inline constexpr int kLinkParameters = 10;
using LinkParameters = Eigen::Matrix<double, kLinkParameters, 1>;
// "mass", "com_x", …, "inertia_xx", …, "inertia_yz": the parameter names without the link.
extern const std::array<std::string_view, kLinkParameters> kLinkParameterNames;

// Inertia matrix from (xx, yy, zz, xy, xz, yz).
Eigen::Matrix3d InertiaMatrix(const LinkParameters& link);

struct Link {
  std::string name;
  LinkParameters parameters = LinkParameters::Zero();  // zero where the URDF has no <inertial>
  bool has_inertial = false;
  int body = -1;  // the moving body this link is part of; -1 is the base
  Pose X_BL;      // pose of the link frame in its body's frame (in W for the base), constant
};

enum class JointType { kRevolute, kContinuous, kPrismatic };
std::string_view JointTypeName(JointType type);

struct Joint {
  std::string name;
  JointType type = JointType::kRevolute;
  int parent = -1;       // parent body, -1 for the base
  int child_link = -1;   // the URDF child link, index into links()
  Eigen::Vector3d axis;  // unit vector in the child link's frame, as declared (normalised)
  Pose X_PB;             // pose of this joint's body frame in the parent body's frame at q = 0
  double lower = 0.0;    // position limits [rad or m]; -inf and +inf for continuous joints
  double upper = 0.0;
  double effort = 0.0;    // limit of |tau| [N·m or N]; +inf where the URDF has none
  double velocity = 0.0;  // limit of |v| [rad/s or m/s]; +inf where the URDF has none
  double damping = 0.0;   // [N·m·s/rad or N·s/m] <dynamics damping>, 0 where absent
  double friction = 0.0;  // [N·m or N] <dynamics friction>, 0 where absent

  bool is_revolute() const { return type != JointType::kPrismatic; }
};

// A joint that follows another, as <mimic> has it: q = multiplier · q_driver + offset, through the whole
// chain where the driver is a mimic itself.
struct Follower {
  Joint joint;
  int driver = -1;          // index into joints()
  double multiplier = 1.0;  // [rad or m per rad or m], not 0
  double offset = 0.0;      // [rad or m]
};

// A frame fixed to a moving body (or to the base, body -1, with the pose in W).
struct Frame {
  int body = -1;
  Pose X_BF;
};

class RobotModel {
 public:
  // What a loader fills in; RobotModel adds nothing but the look-ups. See urdf_loader.h.
  struct Parts {
    std::string name;
    std::string urdf_text;
    std::map<std::string, double> locked;  // LoadOptions::locked
    std::vector<Joint> joints;
    std::vector<Follower> followers;
    std::vector<Link> links;
    int end_effector = -1;                    // index into links
    std::vector<int> joints_without_inertia;  // see JointsWithoutInertia in joint_inertia.h
    std::vector<std::string> warnings;        // what is doubtful or not read, one line each
  };
  explicit RobotModel(Parts parts);

  const std::string& name() const { return parts_.name; }
  // The text the model was made from, to be stored with results.
  const std::string& urdf_text() const { return parts_.urdf_text; }
  // Where joints that do not move are locked, as far as it is not 0 [rad or m].
  const std::map<std::string, double>& locked() const { return parts_.locked; }
  // n, the number of degrees of freedom.
  int num_joints() const { return static_cast<int>(parts_.joints.size()); }
  // n + m: the joints' bodies, then the followers'.
  int num_bodies() const { return num_joints() + static_cast<int>(parts_.followers.size()); }
  int num_links() const { return static_cast<int>(parts_.links.size()); }
  const std::vector<Joint>& joints() const { return parts_.joints; }
  const Joint& joint(int k) const { return parts_.joints[k]; }
  const std::vector<Follower>& followers() const { return parts_.followers; }
  // What moves body b: a joint, or that of a follower.
  const Joint& body_joint(int b) const {
    return b < num_joints() ? parts_.joints[b] : parts_.followers[b - num_joints()].joint;
  }
  // Every link of the URDF, in the order of the document.
  const std::vector<Link>& links() const { return parts_.links; }
  const Link& link(int i) const { return parts_.links[i]; }
  // The link tasks are stated for: LoadOptions::end_effector, or the leaf link behind the most
  // moving joints (the first of the document among equals).
  const Link& end_effector() const { return parts_.links[parts_.end_effector]; }
  // Joints, ascending, that meet no inertia: the mass matrix is singular unless their drives' rotors
  // have some.
  const std::vector<int>& joints_without_inertia() const { return parts_.joints_without_inertia; }
  const std::vector<std::string>& warnings() const { return parts_.warnings; }

  // Index, or -1 if there is no such name (a locked joint is none, a follower is no joint).
  int FindJoint(std::string_view name) const;
  int FindFollower(std::string_view name) const;
  int FindLink(std::string_view name) const;
  // The frame of any link, moving or not.
  std::optional<Frame> FindFrame(std::string_view link_name) const;

  // n × 1 each.
  Eigen::VectorXd LowerLimits() const;
  Eigen::VectorXd UpperLimits() const;
  Eigen::VectorXd EffortLimits() const;
  Eigen::VectorXd VelocityLimits() const;
  // Parameters of all links as loaded, 10 × num_links, columns as links().
  Eigen::Matrix<double, kLinkParameters, Eigen::Dynamic> NominalLinkParameters() const;

 private:
  Parts parts_;
};

}  // namespace rg::model
