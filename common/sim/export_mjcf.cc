#include "common/sim/export_mjcf.h"

#include <tinyxml.h>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <cmath>
#include <initializer_list>

#include "common/sim/export_figures.h"

namespace rg::sim {
namespace {

using Eigen::VectorXd;
using internal::ExactNumber;
using internal::ExportFigures;
using internal::JointFigures;
using model::Pose;

const std::vector<internal::Coverage>& MjcfCovers() {
  static const std::vector<internal::Coverage> rows = {
      {"viscous_friction", nullptr},
      {"coulomb_friction", nullptr},
      {"rotor_inertia", nullptr},
      {"torque_gain", nullptr},
      {"actuator_lag", nullptr},
      {"torque_saturation", nullptr},
      {"payload", nullptr},
      {"gravity_misalignment", nullptr},
      {"position_spring", "only its linear part is in stiffness and springref"},
      {"stribeck_friction", "only its Coulomb level is in frictionloss, not the peak at rest"},
      {"asymmetric_friction", "the mean of both directions is in frictionloss"},
      {"presliding_hysteresis", "only its Coulomb level is in frictionloss, not the bristles"}};
  return rows;
}

std::string Numbers(std::initializer_list<double> values) {
  std::string text;
  for (const double value : values) text += (text.empty() ? "" : " ") + ExactNumber(value);
  return text;
}

// Parent link of every link (-1: the root) as the URDF's joints have it.
std::vector<int> ParentLinks(const model::RobotModel& robot) {
  TiXmlDocument document;
  document.Parse(robot.urdf_text().c_str());
  std::vector<int> parents(static_cast<size_t>(robot.num_links()), -1);
  if (document.RootElement() == nullptr) return parents;
  for (const TiXmlElement* joint = document.RootElement()->FirstChildElement("joint"); joint != nullptr;
       joint = joint->NextSiblingElement("joint")) {
    const TiXmlElement *parent = joint->FirstChildElement("parent"),
                       *child = joint->FirstChildElement("child");
    if (parent == nullptr || child == nullptr) continue;
    const int c = robot.FindLink(child->Attribute("link"));
    if (c >= 0) parents[static_cast<size_t>(c)] = robot.FindLink(parent->Attribute("link"));
  }
  return parents;
}

class MjcfWriter {
 public:
  MjcfWriter(const Plant& plant, const ExportFigures& figures)
      : robot_(plant.model()), figures_(figures), parents_(ParentLinks(robot_)) {}

  std::string Write(double step_s) {
    root_.SetAttribute("model", robot_.name());
    TiXmlElement compiler("compiler"), option("option"), world("worldbody"), equality("equality"),
        actuators("actuator");
    compiler.SetAttribute("angle", "radian");
    compiler.SetAttribute("autolimits", "true");
    const Eigen::Vector3d& g = figures_.gravity;
    option.SetAttribute("timestep", ExactNumber(step_s));
    option.SetAttribute("integrator", "implicitfast");
    option.SetAttribute("gravity", Numbers({g[0], g[1], g[2]}));
    for (int l = 0; l < robot_.num_links(); ++l) {
      if (parents_[static_cast<size_t>(l)] >= 0) continue;
      if (robot_.link(l).name == "world") {  // MuJoCo's own name of what the robot stands on
        AddChildren(l, &world);
      } else {
        world.InsertEndChild(Body(l));
      }
    }
    for (int j = 0; j < robot_.num_joints(); ++j) actuators.InsertEndChild(Actuator(j));
    for (const model::Follower& follower : robot_.followers()) equality.InsertEndChild(Tie(follower));
    for (const TiXmlElement& part : {compiler, option, world, equality, actuators}) {
      if (part.ValueStr() != "equality" || !part.NoChildren()) root_.InsertEndChild(part);
    }
    TiXmlDocument document;
    document.InsertEndChild(root_);
    TiXmlPrinter printer;
    printer.SetIndent("  ");
    document.Accept(&printer);
    return printer.Str();
  }

 private:
  // Pose of link l's frame in its parent link's at q = 0.
  Pose PoseInParent(int l) const {
    const model::Link& link = robot_.link(l);
    const int p = parents_[static_cast<size_t>(l)];
    if (p < 0) return link.X_BL;
    const Pose X_PB = robot_.link(p).X_BL.Inverse();
    if (link.body == robot_.link(p).body) return X_PB * link.X_BL;
    return X_PB * robot_.body_joint(link.body).X_PB * link.X_BL;
  }

  TiXmlElement Body(int l) const {
    TiXmlElement body("body");
    body.SetAttribute("name", robot_.link(l).name);
    const Pose X = PoseInParent(l);
    const Eigen::Quaterniond q = Eigen::Quaterniond(X.rotation).normalized();
    body.SetAttribute("pos", Numbers({X.translation[0], X.translation[1], X.translation[2]}));
    body.SetAttribute("quat", Numbers({q.w(), q.x(), q.y(), q.z()}));
    const auto p = figures_.links.col(l);
    if (!p.isZero(0)) {
      TiXmlElement inertial("inertial");
      inertial.SetAttribute("pos", Numbers({p[1], p[2], p[3]}));
      inertial.SetAttribute("mass", ExactNumber(p[0]));
      inertial.SetAttribute("fullinertia", Numbers({p[4], p[5], p[6], p[7], p[8], p[9]}));
      body.InsertEndChild(inertial);
    }
    for (int j = 0; j < robot_.num_joints(); ++j) {
      if (robot_.joint(j).child_link == l)
        body.InsertEndChild(Joint(robot_.joint(j), figures_.joints[static_cast<size_t>(j)]));
    }
    for (const model::Follower& follower : robot_.followers()) {
      if (follower.joint.child_link != l) continue;
      body.InsertEndChild(Joint(
          follower.joint, {.damping = follower.joint.damping, .friction = follower.joint.friction}));
    }
    AddChildren(l, &body);
    return body;
  }

  void AddChildren(int l, TiXmlElement* body) const {
    for (int child = 0; child < robot_.num_links(); ++child) {
      if (parents_[static_cast<size_t>(child)] == l) body->InsertEndChild(Body(child));
    }
  }

  static TiXmlElement Joint(const model::Joint& joint, const JointFigures& f) {
    TiXmlElement out("joint");
    out.SetAttribute("name", joint.name);
    out.SetAttribute("type", joint.is_revolute() ? "hinge" : "slide");
    out.SetAttribute("axis", Numbers({joint.axis[0], joint.axis[1], joint.axis[2]}));
    if (std::isfinite(joint.lower) && std::isfinite(joint.upper))
      out.SetAttribute("range", Numbers({joint.lower, joint.upper}));
    out.SetAttribute("damping", ExactNumber(f.damping));
    out.SetAttribute("frictionloss", ExactNumber(f.friction));
    out.SetAttribute("armature", ExactNumber(f.armature));
    if (f.stiffness != 0) {
      out.SetAttribute("stiffness", ExactNumber(f.stiffness));
      out.SetAttribute("springref", ExactNumber(f.spring_ref));
    }
    return out;
  }

  // A mimic: q of joint1 is a polynomial of joint2's.
  TiXmlElement Tie(const model::Follower& follower) const {
    TiXmlElement out("joint");
    out.SetAttribute("joint1", follower.joint.name);
    out.SetAttribute("joint2", robot_.joint(follower.driver).name);
    out.SetAttribute("polycoef", Numbers({follower.offset, follower.multiplier, 0, 0, 0}));
    return out;
  }

  TiXmlElement Actuator(int j) const {
    const model::Joint& joint = robot_.joint(j);
    const JointFigures& f = figures_.joints[static_cast<size_t>(j)];
    TiXmlElement out("general");
    out.SetAttribute("name", joint.name);
    out.SetAttribute("joint", joint.name);
    out.SetAttribute("gaintype", "fixed");
    out.SetAttribute("gainprm", ExactNumber(f.gain));
    out.SetAttribute("biastype", "none");
    if (f.lag_s > 0) {
      out.SetAttribute("dyntype", "filterexact");
      out.SetAttribute("dynprm", ExactNumber(f.lag_s));
    }
    if (std::isfinite(f.torque_limit) && f.gain != 0) {
      const double command = f.torque_limit / std::abs(f.gain);
      out.SetAttribute("ctrlrange", Numbers({-command, command}));
    }
    if (std::isfinite(joint.effort)) out.SetAttribute("forcerange", Numbers({-joint.effort, joint.effort}));
    return out;
  }

  const model::RobotModel& robot_;
  const ExportFigures& figures_;
  std::vector<int> parents_;
  TiXmlElement root_{"mujoco"};
};

// What MuJoCo refuses or takes for something else.
Status CheckMjcf(const Plant& plant, const ExportFigures& figures) {
  for (int j = 0; j < plant.num_joints(); ++j) {
    const JointFigures& f = figures.joints[static_cast<size_t>(j)];
    const std::string& name = plant.joint_names()[static_cast<size_t>(j)];
    if (f.damping < 0 || f.friction < 0 || f.armature < 0)
      return InvalidError("joint " + name + ": damping " + ExactNumber(f.damping) + ", frictionloss " +
                          ExactNumber(f.friction) + ", armature " + ExactNumber(f.armature) +
                          ": MuJoCo takes none below zero; identify with bounds before exporting");
  }
  return Status::Ok();
}

// Links whose inertia no body can have, which MuJoCo refuses to load.
void NoteInertias(const Plant& plant, const ExportFigures& figures, std::vector<std::string>* notes) {
  for (int l = 0; l < plant.model().num_links(); ++l) {
    const model::LinkParameters link = figures.links.col(l);
    if (link[0] == 0) continue;
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(model::InertiaMatrix(link));
    const Eigen::Vector3d I = solver.eigenvalues();
    if (I[0] > 0 && I[0] + I[1] >= I[2]) continue;
    notes->push_back(
        "inertia of " + plant.model().link(l).name +
        ": no body can have it (not positive, or breaks the triangle inequality); MuJoCo loads it "
        "only with <compiler balanceinertia=\"true\"/>, which changes it");
  }
}

}  // namespace

Result<ExportedModel> ExportMjcf(const Plant& plant, const VectorXd& values, double step_s) {
  const ExportFigures figures = internal::FiguresOf(plant, values);
  RG_RETURN_IF_ERROR(internal::CheckExportable(plant, figures));
  RG_RETURN_IF_ERROR(CheckMjcf(plant, figures));
  ExportedModel out;
  out.text = MjcfWriter(plant, figures).Write(step_s);
  out.left_out = internal::LeftOut(plant, values, "MJCF", MjcfCovers());
  NoteInertias(plant, figures, &out.left_out);
  for (const model::Follower& follower : plant.model().followers())
    out.left_out.push_back("joint " + follower.joint.name + ": mimics " +
                           plant.joint_names()[static_cast<size_t>(follower.driver)] +
                           " by a soft constraint in MuJoCo (<equality>), exactly here");
  return out;
}

}  // namespace rg::sim
