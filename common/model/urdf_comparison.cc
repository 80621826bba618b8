#include "common/model/urdf_comparison.h"

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <utility>

#include "common/base/number_text.h"
#include "common/model/urdf_xml.h"

namespace rg::model {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kInf = std::numeric_limits<double>::infinity();
constexpr double kPoseRounding = 1e-9;  // of poses and axes, which the model composes

// The attribute of a child element; null where either is missing.
const char* Text(const TiXmlElement& element, const char* child, const char* attribute) {
  const TiXmlElement* found = element.FirstChildElement(child);
  return found == nullptr ? nullptr : found->Attribute(attribute);
}

double Number(const TiXmlElement& element, const char* child, const char* attribute, double absent) {
  const char* text = Text(element, child, attribute);
  double value = std::numeric_limits<double>::quiet_NaN();
  if (text == nullptr) return absent;
  return ParseNumber(text, &value) == NumberText::kOk ? value : std::numeric_limits<double>::quiet_NaN();
}

Vector3d Vector(const TiXmlElement& element, const char* child, const char* attribute,
                const Vector3d& absent) {
  const char* text = Text(element, child, attribute);
  Vector3d value;
  if (text == nullptr) return absent;
  if (ParseNumbers(text, {value.data(), 3}) == NumberText::kOk) return value;
  return Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
}

// By the formula of roll, pitch and yaw written out.
Matrix3d RotationOfOrigin(const TiXmlElement& element) {
  if (const char* text = Text(element, "origin", "quat_xyzw")) {
    std::array<double, 4> q{};
    if (ParseNumbers(text, q) != NumberText::kOk) return Matrix3d::Constant(std::nan(""));
    return Eigen::Quaterniond(q[3], q[0], q[1], q[2]).normalized().toRotationMatrix();
  }
  const Vector3d rpy = Vector(element, "origin", "rpy", Vector3d::Zero());
  const double cr = std::cos(rpy[0]), sr = std::sin(rpy[0]), cp = std::cos(rpy[1]), sp = std::sin(rpy[1]),
               cy = std::cos(rpy[2]), sy = std::sin(rpy[2]);
  Matrix3d R;
  R << cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr,  //
      sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr,   //
      -sp, cp * sr, cp * cr;
  return R;
}

std::string ToText(const Vector3d& v) {
  return NumberToText(v[0]) + " " + NumberToText(v[1]) + " " + NumberToText(v[2]);
}

class Comparison {
 public:
  Comparison(const RobotModel& model, const std::string& source) : model_(model), source_(source) {}

  Status Run() {
    TiXmlDocument document;
    RG_RETURN_IF_ERROR(ParseUrdfXml(model_.urdf_text(), source_, &document));
    const TiXmlElement& robot = *document.RootElement();
    Index(robot);
    size_t links = 0;
    for (const TiXmlElement* e = robot.FirstChildElement("link"); e != nullptr;
         e = e->NextSiblingElement("link"), ++links) {
      RG_RETURN_IF_ERROR(CompareLink(*e));
    }
    if (links != link_of_.size()) return Bug("<robot>", "the model has more links than the document");
    for (const auto& [name, element] : joint_elements_) RG_RETURN_IF_ERROR(CompareJoint(name, *element));
    for (int b = 0; b < model_.num_bodies(); ++b) {
      const std::string& name = model_.body_joint(b).name;
      if (joint_elements_.count(name) == 0) return Bug("joint " + Quoted(name), "is not in the document");
    }
    return Status::Ok();
  }

 private:
  void Index(const TiXmlElement& robot) {
    for (int i = 0; i < model_.num_links(); ++i) link_of_[model_.link(i).name] = i;
    for (int b = 0; b < model_.num_bodies(); ++b) body_of_[model_.body_joint(b).name] = b;
    for (const TiXmlElement* e = robot.FirstChildElement("joint"); e != nullptr;
         e = e->NextSiblingElement("joint")) {
      if (const char* name = e->Attribute("name")) joint_elements_[name] = e;
    }
  }

  Status Bug(const std::string& label, const std::string& what) const {
    return InternalError(source_ + ": " + label + ": " + what + " (a bug of this program: please report it)");
  }
  template <class Value>
  Status Differs(const std::string& label, const std::string& field, const Value& document,
                 const Value& model) const {
    const auto text = [](const Value& v) {
      if constexpr (std::is_same_v<Value, Vector3d>)
        return ToText(v);
      else
        return NumberToText(v);
    };
    return Bug(label, field + ": the document has " + text(document) + ", the model " + text(model));
  }

  // Exactly, but for `tolerance`; NaN differs from everything.
  Status Same(const std::string& label, const std::string& field, double document, double model,
              double tolerance = 0.0) const {
    if (document == model || std::abs(document - model) <= tolerance) return Status::Ok();
    return Differs(label, field, document, model);
  }
  Status Same(const std::string& label, const std::string& field, const Vector3d& document,
              const Vector3d& model, double tolerance) const {
    if ((document - model).norm() <= tolerance) return Status::Ok();
    return Differs(label, field, document, model);
  }

  Status CompareLink(const TiXmlElement& element) const {
    const char* name = element.Attribute("name");
    const std::string label = "link " + Quoted(name == nullptr ? "" : name);
    const auto found = link_of_.find(name == nullptr ? "" : name);
    if (found == link_of_.end()) return Bug(label, "is not in the model");
    const Link& link = model_.link(found->second);
    const TiXmlElement* inertial = element.FirstChildElement("inertial");
    if ((inertial != nullptr) != link.has_inertial) {
      return Bug(label, std::string("<inertial> is ") + (inertial == nullptr
                                                             ? "not in the document, but in the model"
                                                             : "in the document, but not in the model"));
    }
    if (inertial == nullptr) {
      return Same(label, "<mass value>", 0.0, link.parameters.cwiseAbs().maxCoeff());
    }
    RG_RETURN_IF_ERROR(
        Same(label, "<mass value>", Number(*inertial, "mass", "value", std::nan("")), link.parameters[0]));
    RG_RETURN_IF_ERROR(Same(label, "<origin xyz>", Vector(*inertial, "origin", "xyz", Vector3d::Zero()),
                            link.parameters.segment<3>(1), 0.0));
    return CompareInertia(*inertial, link, label);
  }

  // In the document's axes.
  Status CompareInertia(const TiXmlElement& inertial, const Link& link, const std::string& label) const {
    const Matrix3d R = RotationOfOrigin(inertial);
    const Matrix3d I = R.transpose() * InertiaMatrix(link.parameters) * R;
    const double tolerance = 1e-12 * InertiaMatrix(link.parameters).cwiseAbs().sum();
    for (const char* entry : {"ixx", "ixy", "ixz", "iyy", "iyz", "izz"}) {
      RG_RETURN_IF_ERROR(Same(label, "<inertia " + std::string(entry) + ">",
                              Number(inertial, "inertia", entry, std::nan("")),
                              I(entry[1] - 'x', entry[2] - 'x'), tolerance));
    }
    return Status::Ok();
  }

  // Where a joint that does not move stands: by name, or with the joint that it mimics. NaN: nowhere. What is known of
  // one joint of a chain is kept for the others.
  double StandsAt(const std::string& name) const {
    struct Step {
      std::string joint;
      double multiplier, offset;
    };
    std::vector<Step> steps;
    double at = std::nan("");
    for (std::string joint = name; steps.size() <= joint_elements_.size();) {
      const auto locked = model_.locked().find(joint);
      const auto known = stands_at_.find(joint);
      const auto element = joint_elements_.find(joint);
      if (locked != model_.locked().end()) {
        at = locked->second;
        break;
      }
      if (known != stands_at_.end()) {
        at = known->second;
        break;
      }
      if (element == joint_elements_.end()) break;
      const char* driver = IsFixed(*element->second) ? nullptr : Text(*element->second, "mimic", "joint");
      if (driver == nullptr) {
        at = 0.0;
        break;
      }
      steps.push_back({joint, Number(*element->second, "mimic", "multiplier", 1.0),
                       Number(*element->second, "mimic", "offset", 0.0)});
      if (steps.back().multiplier == 0.0) {
        at = 0.0;
        break;
      }
      joint = driver;
    }
    for (auto step = steps.rbegin(); step != steps.rend(); ++step) {
      at = step->multiplier * at + step->offset;
      stands_at_[step->joint] = at;
    }
    return at;
  }

  static bool IsFixed(const TiXmlElement& joint) {
    const char* type = joint.Attribute("type");
    return type != nullptr && std::string_view(type) == "fixed";
  }
  static bool IsPrismatic(const TiXmlElement& joint) {
    const char* type = joint.Attribute("type");
    return type != nullptr && std::string_view(type) == "prismatic";
  }
  static Vector3d Axis(const TiXmlElement& joint) {
    return Vector(joint, "axis", "xyz", Vector3d::UnitX()).stableNormalized();
  }

  Status CompareJoint(const std::string& name, const TiXmlElement& element) const {
    const std::string label = "joint " + Quoted(name);
    const char *parent = Text(element, "parent", "link"), *child = Text(element, "child", "link");
    const auto p = link_of_.find(parent == nullptr ? "" : parent);
    const auto c = link_of_.find(child == nullptr ? "" : child);
    if (p == link_of_.end() || c == link_of_.end()) return Bug(label, "joins links that the model lacks");
    const auto body = body_of_.find(name);
    const bool moves = body != body_of_.end();
    const Link &parent_link = model_.link(p->second), &child_link = model_.link(c->second);
    Pose X_BC = child_link.X_BL;  // in the parent link's body
    if (moves) {
      const Joint& joint = model_.body_joint(body->second);
      if (joint.parent != parent_link.body || child_link.body != body->second ||
          joint.child_link != c->second) {
        return Bug(label, "moves another link than in the document");
      }
      X_BC = joint.X_PB * X_BC;
    } else if (child_link.body != parent_link.body) {
      return Bug(label, "stands, but its links are in different bodies");
    }
    const double reach = parent_link.X_BL.translation.norm() + X_BC.translation.norm();
    RG_RETURN_IF_ERROR(
        ComparePose(element, label, parent_link.X_BL.Inverse() * X_BC, moves ? 0.0 : StandsAt(name), reach));
    return moves ? CompareMovingJoint(element, label, body->second) : Status::Ok();
  }

  // `X`: of the child link in the parent link, with the joint at q; `reach` [m]: of what it was composed of.
  Status ComparePose(const TiXmlElement& element, const std::string& label, const Pose& X, double q,
                     double reach) const {
    Vector3d xyz = Vector(element, "origin", "xyz", Vector3d::Zero());
    Matrix3d R = RotationOfOrigin(element);
    if (IsPrismatic(element)) {
      xyz += R * Axis(element) * q;
    } else if (!IsFixed(element) && q != 0.0) {
      R = R * Eigen::AngleAxisd(q, Axis(element)).toRotationMatrix();
    }
    RG_RETURN_IF_ERROR(Same(label, "<origin xyz>", xyz, X.translation, kPoseRounding * (1.0 + reach)));
    for (int i = 0; i < 3; ++i) {
      RG_RETURN_IF_ERROR(Same(label, "<origin rpy>, column " + std::to_string(i + 1) + " of the rotation",
                              R.col(i), X.rotation.col(i), kPoseRounding));
    }
    return Status::Ok();
  }

  Status CompareMovingJoint(const TiXmlElement& element, const std::string& label, int body) const {
    const Joint& joint = model_.body_joint(body);
    RG_RETURN_IF_ERROR(Same(label, "<axis xyz>", Axis(element), joint.axis, kPoseRounding));
    const bool bounded = joint.type != JointType::kContinuous;
    struct Field {
      const char *child, *attribute;
      double document, model;
    };
    const auto number = [&](const char* child, const char* attribute, double absent) {
      return Number(element, child, attribute, absent);
    };
    for (const Field& f : {
             Field{"limit", "lower", bounded ? number("limit", "lower", 0.0) : -kInf, joint.lower},
             Field{"limit", "upper", bounded ? number("limit", "upper", 0.0) : kInf, joint.upper},
             Field{"limit", "effort", number("limit", "effort", kInf), joint.effort},
             Field{"limit", "velocity", number("limit", "velocity", kInf), joint.velocity},
             Field{"dynamics", "damping", number("dynamics", "damping", 0.0), joint.damping},
             Field{"dynamics", "friction", number("dynamics", "friction", 0.0), joint.friction},
         }) {
      RG_RETURN_IF_ERROR(
          Same(label, "<" + std::string(f.child) + " " + f.attribute + ">", f.document, f.model));
    }
    return CompareMimic(element, label, body);
  }

  Status CompareMimic(const TiXmlElement& element, const std::string& label, int body) const {
    if (body < model_.num_joints()) {
      return Text(element, "mimic", "joint") == nullptr ? Status::Ok() : Bug(label, "<mimic> is lost");
    }
    const Follower& follower = model_.followers()[body - model_.num_joints()];
    double multiplier = 1.0, offset = 0.0;
    const TiXmlElement* at = &element;
    std::string driver;
    for (size_t steps = 0; steps <= joint_elements_.size() && model_.FindJoint(driver) < 0; ++steps) {
      const char* next = Text(*at, "mimic", "joint");
      const auto found = joint_elements_.find(next == nullptr ? "" : next);
      if (found == joint_elements_.end()) return Bug(label, "follows, but mimics no joint");
      offset += multiplier * Number(*at, "mimic", "offset", 0.0);
      multiplier *= Number(*at, "mimic", "multiplier", 1.0);
      driver = found->first;
      at = found->second;
    }
    if (model_.FindJoint(driver) != follower.driver)
      return Bug(label, "<mimic joint>: follows another joint");
    const double rounding = 1e-12 * (std::abs(multiplier) + std::abs(offset));
    RG_RETURN_IF_ERROR(Same(label, "<mimic multiplier>", multiplier, follower.multiplier, rounding));
    return Same(label, "<mimic offset>", offset, follower.offset, rounding);
  }

  const RobotModel& model_;
  const std::string& source_;
  std::map<std::string, int> link_of_, body_of_;
  std::map<std::string, const TiXmlElement*> joint_elements_;
  mutable std::map<std::string, double> stands_at_;  // mimics looked at so far
};

}  // namespace

Status CompareWithDocument(const RobotModel& model, const std::string& source_name) {
  return Comparison(model, source_name).Run();
}

}  // namespace rg::model
