#include "common/model/urdf_document.h"

#include <tinyxml.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <map>
#include <set>
#include <string_view>

namespace rg::model {
namespace {

std::string Quoted(std::string_view text) { return "'" + std::string(text) + "'"; }

// Reads whitespace-separated decimal numbers; false if there is anything else or not `count` of them.
bool ParseNumbers(std::string_view text, size_t count, std::vector<double>& out) {
  out.clear();
  const char* at = text.data();
  const char* end = at + text.size();
  while (true) {
    while (at != end && std::string_view(" \t\r\n").find(*at) != std::string_view::npos) ++at;
    if (at == end) return out.size() == count;
    if (*at == '+') ++at;
    double value = 0.0;
    const auto [next, error] = std::from_chars(at, end, value);
    if (error != std::errc() ||
        (next != end && std::string_view(" \t\r\n").find(*next) == std::string_view::npos)) {
      return false;
    }
    out.push_back(value);
    at = next;
  }
}

class DocumentCheck {
 public:
  explicit DocumentCheck(const std::string& source_name) : source_(source_name) {}

  Result<UrdfOutline> Run(const std::string& xml) {
    TiXmlDocument document;
    document.Parse(xml.c_str());
    if (document.Error()) {
      return InvalidError(source_ + ": row " + std::to_string(document.ErrorRow()) +
                          ": not well-formed XML: " + document.ErrorDesc());
    }
    const TiXmlElement* robot = document.RootElement();
    if (robot == nullptr || robot->ValueStr() != "robot") {
      return InvalidError(source_ + ": the root element is not <robot>");
    }
    const char* name = robot->Attribute("name");
    if (name == nullptr || *name == '\0') return InvalidError(source_ + ": <robot> has no name");
    outline_.robot_name = name;
    RG_RETURN_IF_ERROR(CheckLinks(*robot));
    RG_RETURN_IF_ERROR(CheckJoints(*robot));
    RG_RETURN_IF_ERROR(CheckTree());
    return std::move(outline_);
  }

 private:
  Status Error(const std::string& element, const std::string& what) const {
    return InvalidError(source_ + ": " + element + ": " + what);
  }

  // Name of a <link> or <joint>, unique among its kind.
  Status TakeName(const TiXmlElement& element, std::vector<std::string>& names, std::string& label) {
    const char* name = element.Attribute("name");
    if (name == nullptr || *name == '\0') {
      return InvalidError(source_ + ": row " + std::to_string(element.Row()) + ": <" + element.ValueStr() +
                          "> has no name");
    }
    label = element.ValueStr() + " " + Quoted(name);
    if (std::find(names.begin(), names.end(), name) != names.end()) {
      return Error(label, "the name is used twice (row " + std::to_string(element.Row()) + ")");
    }
    names.push_back(name);
    return Status::Ok();
  }

  Status AtMostOne(const TiXmlElement& element, const char* child, const std::string& label) const {
    const TiXmlElement* first = element.FirstChildElement(child);
    if (first != nullptr && first->NextSiblingElement(child) != nullptr) {
      return Error(label, "<" + std::string(child) + "> is there twice");
    }
    return Status::Ok();
  }

  // An attribute of `count` finite numbers; absent is allowed unless `required`.
  Status Numbers(const TiXmlElement& element, const char* attribute, size_t count, bool required,
                 const std::string& label, std::vector<double>& out) const {
    out.clear();
    const std::string field = label + ": <" + element.ValueStr() + " " + attribute + ">";
    const char* text = element.Attribute(attribute);
    if (text == nullptr) {
      if (required) return InvalidError(source_ + ": " + field + " is missing");
      return Status::Ok();
    }
    if (!ParseNumbers(text, count, out)) {
      return InvalidError(source_ + ": " + field + ": " + Quoted(text) + " is not " +
                          (count == 1 ? "a number" : std::to_string(count) + " numbers"));
    }
    for (double value : out) {
      if (!std::isfinite(value)) {
        return InvalidError(source_ + ": " + field + ": " + Quoted(text) + " is not finite");
      }
    }
    return Status::Ok();
  }

  Status CheckOrigin(const TiXmlElement& element, const std::string& label) const {
    RG_RETURN_IF_ERROR(AtMostOne(element, "origin", label));
    const TiXmlElement* origin = element.FirstChildElement("origin");
    if (origin == nullptr) return Status::Ok();
    std::vector<double> numbers;
    RG_RETURN_IF_ERROR(Numbers(*origin, "xyz", 3, false, label, numbers));
    return Numbers(*origin, "rpy", 3, false, label, numbers);
  }

  Status CheckInertial(const TiXmlElement& link, const std::string& label) const {
    RG_RETURN_IF_ERROR(AtMostOne(link, "inertial", label));
    const TiXmlElement* inertial = link.FirstChildElement("inertial");
    if (inertial == nullptr) return Status::Ok();
    RG_RETURN_IF_ERROR(CheckOrigin(*inertial, label));
    for (const char* child : {"mass", "inertia"}) {
      RG_RETURN_IF_ERROR(AtMostOne(*inertial, child, label));
      if (inertial->FirstChildElement(child) == nullptr) {
        return Error(label, "<inertial> has no <" + std::string(child) + ">");
      }
    }
    std::vector<double> numbers;
    const TiXmlElement& mass = *inertial->FirstChildElement("mass");
    RG_RETURN_IF_ERROR(Numbers(mass, "value", 1, true, label, numbers));
    if (numbers[0] < 0.0) {
      return Error(label, "<mass value>: " + Quoted(mass.Attribute("value")) + " is negative");
    }
    for (const char* entry : {"ixx", "ixy", "ixz", "iyy", "iyz", "izz"}) {
      RG_RETURN_IF_ERROR(Numbers(*inertial->FirstChildElement("inertia"), entry, 1, true, label, numbers));
      if (entry[1] == entry[2] && numbers[0] < 0.0) {
        return Error(label, "<inertia " + std::string(entry) + ">: a negative moment of inertia");
      }
    }
    return Status::Ok();
  }

  Status CheckLinks(const TiXmlElement& robot) {
    for (const TiXmlElement* link = robot.FirstChildElement("link"); link != nullptr;
         link = link->NextSiblingElement("link")) {
      std::string label;
      RG_RETURN_IF_ERROR(TakeName(*link, outline_.links, label));
      RG_RETURN_IF_ERROR(CheckInertial(*link, label));
    }
    if (outline_.links.empty()) return InvalidError(source_ + ": <robot> has no links");
    return Status::Ok();
  }

  Status TakeEnd(const TiXmlElement& joint, const char* end, const std::string& label,
                 std::string& link) const {
    RG_RETURN_IF_ERROR(AtMostOne(joint, end, label));
    const TiXmlElement* element = joint.FirstChildElement(end);
    const char* name = element == nullptr ? nullptr : element->Attribute("link");
    if (name == nullptr) return Error(label, "<" + std::string(end) + " link> is missing");
    if (std::find(outline_.links.begin(), outline_.links.end(), name) == outline_.links.end()) {
      return Error(label, std::string(end) + " link " + Quoted(name) + " does not exist");
    }
    link = name;
    return Status::Ok();
  }

  Status CheckAxis(const TiXmlElement& joint, const std::string& label) const {
    RG_RETURN_IF_ERROR(AtMostOne(joint, "axis", label));
    const TiXmlElement* axis = joint.FirstChildElement("axis");
    if (axis == nullptr) return Status::Ok();
    std::vector<double> n;
    RG_RETURN_IF_ERROR(Numbers(*axis, "xyz", 3, true, label, n));
    if (std::hypot(n[0], n[1], n[2]) < 1e-9) {
      return Error(label, "<axis xyz>: " + Quoted(axis->Attribute("xyz")) + " has no direction");
    }
    return Status::Ok();
  }

  Status CheckLimits(const TiXmlElement& joint, const std::string& type, const std::string& label) const {
    RG_RETURN_IF_ERROR(AtMostOne(joint, "limit", label));
    const TiXmlElement* limit = joint.FirstChildElement("limit");
    const bool bounded = type == "revolute" || type == "prismatic";
    if (limit == nullptr) {
      return bounded ? Error(label, "a " + type + " joint needs <limit>") : Status::Ok();
    }
    std::vector<double> lower, upper, number;
    RG_RETURN_IF_ERROR(Numbers(*limit, "lower", 1, false, label, lower));
    RG_RETURN_IF_ERROR(Numbers(*limit, "upper", 1, false, label, upper));
    if (bounded) {
      const double low = lower.empty() ? 0.0 : lower[0];
      const double high = upper.empty() ? 0.0 : upper[0];
      if (low > high) {
        return Error(label,
                     "<limit>: lower " + std::to_string(low) + " is above upper " + std::to_string(high));
      }
    }
    for (const char* attribute : {"effort", "velocity"}) {
      RG_RETURN_IF_ERROR(Numbers(*limit, attribute, 1, true, label, number));
      if (number[0] < 0.0) return Error(label, "<limit " + std::string(attribute) + ">: is negative");
    }
    return Status::Ok();
  }

  Status CheckDynamics(const TiXmlElement& joint, const std::string& label) const {
    RG_RETURN_IF_ERROR(AtMostOne(joint, "dynamics", label));
    const TiXmlElement* dynamics = joint.FirstChildElement("dynamics");
    if (dynamics == nullptr) return Status::Ok();
    std::vector<double> number;
    for (const char* attribute : {"damping", "friction"}) {
      RG_RETURN_IF_ERROR(Numbers(*dynamics, attribute, 1, false, label, number));
      if (!number.empty() && number[0] < 0.0) {
        return Error(label, "<dynamics " + std::string(attribute) + ">: is negative");
      }
    }
    return Status::Ok();
  }

  Status CheckJoint(const TiXmlElement& joint) {
    std::string label, parent, child;
    RG_RETURN_IF_ERROR(TakeName(joint, outline_.joints, label));
    const std::string type = joint.Attribute("type") == nullptr ? "" : joint.Attribute("type");
    if (type != "fixed" && type != "revolute" && type != "continuous" && type != "prismatic") {
      return Error(label,
                   "type " + Quoted(type) + " is not supported (revolute, continuous, prismatic, fixed)");
    }
    RG_RETURN_IF_ERROR(TakeEnd(joint, "parent", label, parent));
    RG_RETURN_IF_ERROR(TakeEnd(joint, "child", label, child));
    RG_RETURN_IF_ERROR(CheckOrigin(joint, label));
    if (const auto [it, fresh] = parent_of_.emplace(child, parent); !fresh) {
      return Error(label, "link " + Quoted(child) + " already has the parent " + Quoted(it->second) +
                              ": loops cannot be represented");
    }
    if (type == "fixed") return Status::Ok();
    RG_RETURN_IF_ERROR(CheckAxis(joint, label));
    RG_RETURN_IF_ERROR(CheckLimits(joint, type, label));
    return CheckDynamics(joint, label);
  }

  Status CheckJoints(const TiXmlElement& robot) {
    for (const TiXmlElement* joint = robot.FirstChildElement("joint"); joint != nullptr;
         joint = joint->NextSiblingElement("joint")) {
      RG_RETURN_IF_ERROR(CheckJoint(*joint));
    }
    return Status::Ok();
  }

  // Every link has at most one parent by now, so what does not hang on the one root is a loop.
  Status CheckTree() const {
    std::string root;
    for (const std::string& link : outline_.links) {
      if (parent_of_.contains(link)) continue;
      if (!root.empty()) {
        return InvalidError(source_ + ": links " + Quoted(root) + " and " + Quoted(link) +
                            " are both roots: one tree is needed");
      }
      root = link;
    }
    if (root.empty()) return InvalidError(source_ + ": no root link: the joints form a loop");
    for (const std::string& link : outline_.links) {
      std::string at = link;
      for (size_t steps = 0; at != root; ++steps) {
        if (steps > outline_.links.size())
          return Error("link " + Quoted(link), "is part of a loop of joints");
        at = parent_of_.at(at);
      }
    }
    return Status::Ok();
  }

  const std::string source_;
  UrdfOutline outline_;
  std::map<std::string, std::string> parent_of_;
};

}  // namespace

Result<UrdfOutline> CheckUrdfDocument(const std::string& xml, const std::string& source_name) {
  return DocumentCheck(source_name).Run(xml);
}

}  // namespace rg::model
