#include "common/model/urdf_document.h"

#include <Eigen/Geometry>
#include <cmath>
#include <set>
#include <span>
#include <string_view>
#include <utility>

#include "common/base/number_text.h"
#include "common/model/urdf_leftovers.h"
#include "common/model/urdf_xml.h"

namespace rg::model {
namespace {

// URDF's rpy: about the fixed x, then y, then z.
Eigen::Matrix3d FromRpy(const Eigen::Vector3d& rpy) {
  if (rpy.isZero(0.0)) return Eigen::Matrix3d::Identity();
  using Eigen::AngleAxisd, Eigen::Vector3d;
  return (AngleAxisd(rpy[2], Vector3d::UnitZ()) * AngleAxisd(rpy[1], Vector3d::UnitY()) *
          AngleAxisd(rpy[0], Vector3d::UnitX()))
      .toRotationMatrix();
}

constexpr double kMostMass = 1e6, kMostLength = 1e7, kMostInertia = 1e9;  // kg, m, kg m^2

class DocumentReader {
 public:
  explicit DocumentReader(const std::string& source_name) : source_(source_name) {}

  Result<UrdfDocument> Run(const std::string& xml) {
    TiXmlDocument document;
    RG_RETURN_IF_ERROR(ParseUrdfXml(xml, source_, &document));
    const TiXmlElement& robot = *document.RootElement();
    const char* name = robot.Attribute("name");
    if (name == nullptr || *name == '\0') return InvalidError(source_ + ": <robot> has no name");
    out_.robot_name = name;
    RG_RETURN_IF_ERROR(ReadLinks(robot));
    RG_RETURN_IF_ERROR(ReadJoints(robot));
    RG_RETURN_IF_ERROR(MakeTree());
    for (std::string& line : UrdfLeftovers(robot, source_)) out_.warnings.push_back(std::move(line));
    return std::move(out_);
  }

 private:
  Status Error(const std::string& element, const std::string& what) const {
    return InvalidError(source_ + ": " + element + ": " + what);
  }
  static std::string Tag(const TiXmlElement& element, const std::string& attribute) {
    return "<" + element.ValueStr() + " " + attribute + ">";
  }

  // Name of a <link> or <joint>, unique among its kind.
  Status TakeName(const TiXmlElement& element, int index, std::map<std::string, int>* names,
                  std::string* name, std::string* label) const {
    const char* text = element.Attribute("name");
    const std::string row = "row " + std::to_string(element.Row());
    if (text == nullptr || *text == '\0') {
      return InvalidError(source_ + ": " + row + ": <" + element.ValueStr() + "> has no name");
    }
    *name = text;
    *label = element.ValueStr() + " " + Quoted(text);
    if (!names->emplace(*name, index).second) return Error(*label, "the name is used twice (" + row + ")");
    return Status::Ok();
  }

  // The child element, null if there is none; twice is an error.
  Status OnlyChild(const TiXmlElement& element, const char* child, const std::string& label,
                   const TiXmlElement** found) const {
    *found = element.FirstChildElement(child);
    if (*found != nullptr && (*found)->NextSiblingElement(child) != nullptr) {
      return Error(label, "<" + std::string(child) + "> is there twice");
    }
    return Status::Ok();
  }

  Status NumbersError(const TiXmlElement& element, const char* attribute, size_t count,
                      const std::string& label, NumberText outcome) const {
    const char* text = element.Attribute(attribute);
    std::string what(NumberTextMessage(outcome));
    if (outcome == NumberText::kWrongCount || (outcome == NumberText::kNotANumber && count > 1)) {
      what = count == 1 ? "is not a number" : "is not " + std::to_string(count) + " numbers";
    }
    if (outcome == NumberText::kNotANumber && std::string_view(text).find(',') != std::string_view::npos) {
      what += " (blanks stand between numbers, a point before decimals)";
    }
    return Error(label, Tag(element, attribute) + ": " + Quoted(text) + " " + what);
  }

  // An attribute of finite numbers; leaves `values` alone where it is absent.
  Status Numbers(const TiXmlElement& element, const char* attribute, const std::string& label,
                 std::span<double> values) const {
    const char* text = element.Attribute(attribute);
    if (text == nullptr) return Status::Ok();
    const NumberText outcome = ParseNumbers(text, values);
    if (outcome == NumberText::kOk) return Status::Ok();
    return NumbersError(element, attribute, values.size(), label, outcome);
  }
  Status Number(const TiXmlElement& element, const char* attribute, const std::string& label,
                double* value) const {
    return Numbers(element, attribute, label, {value, 1});
  }
  Status Required(const TiXmlElement& element, const char* attribute, const std::string& label) const {
    if (element.Attribute(attribute) != nullptr) return Status::Ok();
    return Error(label, Tag(element, attribute) + " is missing");
  }
  Status NotNegative(const TiXmlElement& element, const char* attribute, const std::string& label,
                     double value) const {
    if (!(value < 0.0)) return Status::Ok();
    return Error(label,
                 Tag(element, attribute) + ": " + Quoted(element.Attribute(attribute)) + " is negative");
  }

  // What would overflow in the dynamics, and is no robot.
  Status NotBeyond(const TiXmlElement& element, const char* attribute, const std::string& label, double value,
                   double most) const {
    if (std::abs(value) <= most) return Status::Ok();
    return Error(label, Tag(element, attribute) + ": " + Quoted(element.Attribute(attribute)) +
                            " is beyond any robot (SI units: kg, m, kg m^2)");
  }

  Status ReadQuaternion(const TiXmlElement& origin, const std::string& label, Eigen::Matrix3d* rotation) {
    if (origin.Attribute("rpy") != nullptr) {
      return Error(label, "<origin> has both rpy and quat_xyzw");
    }
    double q[4] = {0.0, 0.0, 0.0, 1.0};
    RG_RETURN_IF_ERROR(Numbers(origin, "quat_xyzw", label, q));
    const double norm = std::hypot(std::hypot(q[0], q[1]), std::hypot(q[2], q[3]));
    if (!(std::abs(norm - 1.0) < 1e-3)) {
      return Error(label, Tag(origin, "quat_xyzw") + ": " + Quoted(origin.Attribute("quat_xyzw")) +
                              " is not of length 1");
    }
    *rotation = Eigen::Quaterniond(q[3], q[0], q[1], q[2]).normalized().toRotationMatrix();
    out_.warnings.push_back(source_ + ": " + label +
                            ": <origin quat_xyzw> is taken as the rotation, which older readers of URDF "
                            "do not do");
    return Status::Ok();
  }

  Status ReadOrigin(const TiXmlElement& element, const std::string& label, Pose* pose) {
    const TiXmlElement* origin = nullptr;
    RG_RETURN_IF_ERROR(OnlyChild(element, "origin", label, &origin));
    if (origin == nullptr) return Status::Ok();
    Eigen::Vector3d rpy = Eigen::Vector3d::Zero();
    RG_RETURN_IF_ERROR(Numbers(*origin, "xyz", label, {pose->translation.data(), 3}));
    RG_RETURN_IF_ERROR(
        NotBeyond(*origin, "xyz", label, pose->translation.cwiseAbs().maxCoeff(), kMostLength));
    RG_RETURN_IF_ERROR(Numbers(*origin, "rpy", label, {rpy.data(), 3}));
    pose->rotation = FromRpy(rpy);
    if (rpy.cwiseAbs().maxCoeff() > 2.0 * M_PI + 0.01) {
      out_.warnings.push_back(source_ + ": " + label + ": <origin rpy>: " + Quoted(origin->Attribute("rpy")) +
                              " is more than a turn: URDF wants radians");
    }
    return origin->Attribute("quat_xyzw") == nullptr ? Status::Ok()
                                                     : ReadQuaternion(*origin, label, &pose->rotation);
  }

  Status ReadMass(const TiXmlElement& mass, const std::string& label, double* value) const {
    RG_RETURN_IF_ERROR(Required(mass, "value", label));
    RG_RETURN_IF_ERROR(Number(mass, "value", label, value));
    RG_RETURN_IF_ERROR(NotNegative(mass, "value", label, *value));
    return NotBeyond(mass, "value", label, *value, kMostMass);
  }

  Status ReadInertia(const TiXmlElement& inertia, const std::string& label, Eigen::Matrix3d* I) const {
    for (const char* entry : {"ixx", "ixy", "ixz", "iyy", "iyz", "izz"}) {
      const int row = entry[1] - 'x', column = entry[2] - 'x';
      RG_RETURN_IF_ERROR(Required(inertia, entry, label));
      RG_RETURN_IF_ERROR(Number(inertia, entry, label, &(*I)(row, column)));
      if (row == column) RG_RETURN_IF_ERROR(NotNegative(inertia, entry, label, (*I)(row, row)));
      RG_RETURN_IF_ERROR(NotBeyond(inertia, entry, label, (*I)(row, column), kMostInertia));
      (*I)(column, row) = (*I)(row, column);
    }
    return Status::Ok();
  }

  Status ReadInertial(const TiXmlElement& link, const std::string& label, UrdfLink* out) {
    const TiXmlElement *inertial = nullptr, *mass = nullptr, *inertia = nullptr;
    RG_RETURN_IF_ERROR(OnlyChild(link, "inertial", label, &inertial));
    if (inertial == nullptr) return Status::Ok();
    RG_RETURN_IF_ERROR(OnlyChild(*inertial, "mass", label, &mass));
    RG_RETURN_IF_ERROR(OnlyChild(*inertial, "inertia", label, &inertia));
    if (mass == nullptr) return Error(label, "<inertial> has no <mass>");
    if (inertia == nullptr) return Error(label, "<inertial> has no <inertia>");
    out->inertial.emplace();
    RG_RETURN_IF_ERROR(ReadOrigin(*inertial, label, &out->inertial->origin));
    RG_RETURN_IF_ERROR(ReadMass(*mass, label, &out->inertial->mass));
    return ReadInertia(*inertia, label, &out->inertial->inertia);
  }

  Status ReadLinks(const TiXmlElement& robot) {
    for (const TiXmlElement* e = robot.FirstChildElement("link"); e != nullptr;
         e = e->NextSiblingElement("link")) {
      UrdfLink link;
      std::string label;
      RG_RETURN_IF_ERROR(TakeName(*e, static_cast<int>(out_.links.size()), &link_index_, &link.name, &label));
      RG_RETURN_IF_ERROR(ReadInertial(*e, label, &link));
      out_.links.push_back(std::move(link));
    }
    if (out_.links.empty()) return InvalidError(source_ + ": <robot> has no links");
    return Status::Ok();
  }

  Status ReadType(const TiXmlElement& element, const std::string& label, UrdfJoint* joint) const {
    static const std::map<std::string, JointType> kMoving = {{"revolute", JointType::kRevolute},
                                                             {"continuous", JointType::kContinuous},
                                                             {"prismatic", JointType::kPrismatic}};
    RG_RETURN_IF_ERROR(Required(element, "type", label));
    const std::string type = element.Attribute("type");
    const auto moving = kMoving.find(type);
    joint->is_fixed = type == "fixed";
    if (moving != kMoving.end()) joint->type = moving->second;
    if (joint->is_fixed || moving != kMoving.end()) return Status::Ok();
    return Error(label,
                 "type " + Quoted(type) + " is not supported (revolute, continuous, prismatic, fixed)");
  }

  Status ReadEnd(const TiXmlElement& joint, const char* end, const std::string& label, int* link) const {
    const TiXmlElement* element = nullptr;
    RG_RETURN_IF_ERROR(OnlyChild(joint, end, label, &element));
    const char* name = element == nullptr ? nullptr : element->Attribute("link");
    if (name == nullptr) return Error(label, "<" + std::string(end) + " link> is missing");
    const auto found = link_index_.find(name);
    if (found == link_index_.end()) {
      return Error(label, std::string(end) + " link " + Quoted(name) + " does not exist");
    }
    *link = found->second;
    return Status::Ok();
  }

  Status ReadAxis(const TiXmlElement& joint, const std::string& label, Eigen::Vector3d* axis) const {
    const TiXmlElement* element = nullptr;
    RG_RETURN_IF_ERROR(OnlyChild(joint, "axis", label, &element));
    if (element == nullptr) return Status::Ok();
    RG_RETURN_IF_ERROR(Required(*element, "xyz", label));
    RG_RETURN_IF_ERROR(Numbers(*element, "xyz", label, {axis->data(), 3}));
    const double length = axis->stableNorm();
    if (!(length >= 1e-9) || !std::isfinite(length)) {
      return Error(label, "<axis xyz>: " + Quoted(element->Attribute("xyz")) + " has no direction");
    }
    *axis /= length;
    return Status::Ok();
  }

  Status ReadLimit(const TiXmlElement& joint, const std::string& label, UrdfJoint* out) const {
    const TiXmlElement* limit = nullptr;
    RG_RETURN_IF_ERROR(OnlyChild(joint, "limit", label, &limit));
    const bool bounded = out->type != JointType::kContinuous;
    if (limit == nullptr && !bounded) return Status::Ok();
    if (limit == nullptr) {
      return Error(label, "a " + std::string(JointTypeName(out->type)) + " joint needs <limit>");
    }
    RG_RETURN_IF_ERROR(Number(*limit, "lower", label, &out->lower));
    RG_RETURN_IF_ERROR(Number(*limit, "upper", label, &out->upper));
    if (bounded && out->lower > out->upper) {
      return Error(label, "<limit>: lower " + NumberToText(out->lower) + " is above upper " +
                              NumberToText(out->upper));
    }
    for (const auto& [attribute, value] :
         {std::pair{"effort", &out->effort}, std::pair{"velocity", &out->velocity}}) {
      RG_RETURN_IF_ERROR(Required(*limit, attribute, label));
      RG_RETURN_IF_ERROR(Number(*limit, attribute, label, &value->emplace(0.0)));
      RG_RETURN_IF_ERROR(NotNegative(*limit, attribute, label, **value));
    }
    return Status::Ok();
  }

  Status ReadDynamics(const TiXmlElement& joint, const std::string& label, UrdfJoint* out) const {
    const TiXmlElement* dynamics = nullptr;
    RG_RETURN_IF_ERROR(OnlyChild(joint, "dynamics", label, &dynamics));
    if (dynamics == nullptr) return Status::Ok();
    for (const auto& [attribute, value] :
         {std::pair{"damping", &out->damping}, std::pair{"friction", &out->friction}}) {
      RG_RETURN_IF_ERROR(Number(*dynamics, attribute, label, value));
      RG_RETURN_IF_ERROR(NotNegative(*dynamics, attribute, label, *value));
    }
    return Status::Ok();
  }

  Status ReadMimic(const TiXmlElement& joint, const std::string& label, UrdfJoint* out) const {
    const TiXmlElement* element = nullptr;
    RG_RETURN_IF_ERROR(OnlyChild(joint, "mimic", label, &element));
    if (element == nullptr) return Status::Ok();
    UrdfMimic& mimic = out->mimic.emplace();
    RG_RETURN_IF_ERROR(Required(*element, "joint", label));
    mimic.driver = element->Attribute("joint");
    RG_RETURN_IF_ERROR(Number(*element, "multiplier", label, &mimic.multiplier));
    return Number(*element, "offset", label, &mimic.offset);
  }

  Status ReadJoint(const TiXmlElement& element) {
    UrdfJoint joint;
    std::string label;
    const int index = static_cast<int>(out_.joints.size());
    RG_RETURN_IF_ERROR(TakeName(element, index, &joint_index_, &joint.name, &label));
    RG_RETURN_IF_ERROR(ReadType(element, label, &joint));
    RG_RETURN_IF_ERROR(ReadEnd(element, "parent", label, &joint.parent));
    RG_RETURN_IF_ERROR(ReadEnd(element, "child", label, &joint.child));
    RG_RETURN_IF_ERROR(ReadOrigin(element, label, &joint.origin));
    if (const auto [it, fresh] = parent_of_.emplace(joint.child, joint.parent); !fresh) {
      return Error(label, "link " + Quoted(out_.links[joint.child].name) + " already has the parent " +
                              Quoted(out_.links[it->second].name) + ": loops cannot be represented");
    }
    if (!joint.is_fixed) {
      RG_RETURN_IF_ERROR(ReadAxis(element, label, &joint.axis));
      RG_RETURN_IF_ERROR(ReadLimit(element, label, &joint));
      RG_RETURN_IF_ERROR(ReadDynamics(element, label, &joint));
      RG_RETURN_IF_ERROR(ReadMimic(element, label, &joint));
    }
    out_.joints.push_back(std::move(joint));
    return Status::Ok();
  }

  Status ReadJoints(const TiXmlElement& robot) {
    for (const TiXmlElement* joint = robot.FirstChildElement("joint"); joint != nullptr;
         joint = joint->NextSiblingElement("joint")) {
      RG_RETURN_IF_ERROR(ReadJoint(*joint));
    }
    return Status::Ok();
  }

  // Every link has at most one parent by now, so what does not hang on the one root is a loop.
  Status MakeTree() {
    const int n = static_cast<int>(out_.links.size());
    for (int link = 0; link < n; ++link) {
      if (parent_of_.contains(link)) continue;
      if (out_.root >= 0) {
        return InvalidError(source_ + ": links " + Quoted(out_.links[out_.root].name) + " and " +
                            Quoted(out_.links[link].name) + " are both roots: one tree is needed");
      }
      out_.root = link;
    }
    if (out_.root < 0) return InvalidError(source_ + ": no root link: the joints form a loop");
    out_.child_joints.resize(n);
    for (size_t j = 0; j < out_.joints.size(); ++j) {
      out_.child_joints[out_.joints[j].parent].push_back(static_cast<int>(j));
    }
    return CheckReached();
  }

  Status CheckReached() const {
    std::vector<bool> reached(out_.links.size(), false);
    std::vector<int> to_visit = {out_.root};
    while (!to_visit.empty()) {
      const int link = to_visit.back();
      to_visit.pop_back();
      reached[link] = true;
      for (const int j : out_.child_joints[link]) to_visit.push_back(out_.joints[j].child);
    }
    for (size_t i = 0; i < reached.size(); ++i) {
      if (!reached[i]) return Error("link " + Quoted(out_.links[i].name), "is part of a loop of joints");
    }
    return Status::Ok();
  }

  const std::string source_;
  UrdfDocument out_;
  std::map<std::string, int> link_index_, joint_index_;
  std::map<int, int> parent_of_;  // links
};

}  // namespace

std::vector<std::string> UrdfDocument::JointNames() const {
  std::vector<std::string> names;
  for (const UrdfJoint& joint : joints) names.push_back(joint.name);
  return names;
}

Result<UrdfDocument> ReadUrdfDocument(const std::string& xml, const std::string& source_name) {
  return DocumentReader(source_name).Run(xml);
}

}  // namespace rg::model
