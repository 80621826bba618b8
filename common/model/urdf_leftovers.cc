#include "common/model/urdf_leftovers.h"

#include <map>
#include <set>
#include <string_view>
#include <utility>

#include "common/base/number_text.h"
#include "common/model/urdf_xml.h"

namespace rg::model {
namespace {

using Names = std::set<std::string, std::less<>>;

// What is read of an element.
struct Read {
  Names attributes;
  Names children;
};

const std::map<std::string, Read, std::less<>>& WhatIsRead() {
  static const std::map<std::string, Read, std::less<>> read = {
      {"robot", {{"name", "version"}, {"link", "joint"}}},
      {"link", {{"name"}, {"inertial"}}},
      {"inertial", {{}, {"origin", "mass", "inertia"}}},
      {"mass", {{"value"}, {}}},
      {"inertia", {{"ixx", "ixy", "ixz", "iyy", "iyz", "izz"}, {}}},
      {"origin", {{"xyz", "rpy", "quat_xyzw"}, {}}},
      {"joint", {{"name", "type"}, {"parent", "child", "origin", "axis", "limit", "dynamics", "mimic"}}},
      {"parent", {{"link"}, {}}},
      {"child", {{"link"}, {}}},
      {"axis", {{"xyz"}, {}}},
      {"limit", {{"lower", "upper", "effort", "velocity"}, {}}},
      {"dynamics", {{"damping", "friction"}, {}}},
      {"mimic", {{"joint", "multiplier", "offset"}, {}}},
  };
  return read;
}

bool IsSilent(std::string_view element) {
  static const Names silent = {"visual", "collision",    "material", "transmission",
                               "gazebo", "ros2_control", "sensor"};
  return silent.contains(element);
}

bool DeclaresNamespace(const std::string& attribute) {
  return attribute == "xmlns" || attribute.starts_with("xmlns:");
}

// Where an element that is read elsewhere belongs: " (it belongs into <inertial>)".
std::string Home(const std::string& element, const std::string& found_in) {
  for (const auto& [home, read] : WhatIsRead()) {
    if (home != found_in && element != "origin" && read.children.contains(element)) {
      return " (it belongs into <" + home + ">)";
    }
  }
  return "";
}

bool AllNumbersAreZero(const TiXmlElement& element) {
  for (const TiXmlAttribute* a = element.FirstAttribute(); a != nullptr; a = a->Next()) {
    double value = 0.0;
    if (ParseNumber(a->ValueStr(), &value) != NumberText::kOk || value != 0.0) return false;
  }
  return true;
}

class Search {
 public:
  explicit Search(const std::string& source_name) : source_(source_name) {}

  std::vector<std::string> Run(const TiXmlElement& robot) {
    CheckVersion(robot);
    Visit(robot, "");
    return std::move(lines_);
  }

 private:
  // `owner`: "joint 'elbow': " or "" for the robot itself.
  void Say(const std::string& owner, const std::string& what) {
    std::string line = source_ + ": " + owner + what;
    if (said_.insert(line).second) lines_.push_back(std::move(line));
  }

  void CheckVersion(const TiXmlElement& robot) {
    const char* version = robot.Attribute("version");
    if (version == nullptr || std::string_view(version).starts_with("1")) return;
    Say("", "<robot version>: " + Quoted(version) + " is not known; read as version 1");
  }

  void Visit(const TiXmlElement& element, const std::string& owner) {
    const Read& read = WhatIsRead().find(element.ValueStr())->second;
    for (const TiXmlAttribute* a = element.FirstAttribute(); a != nullptr; a = a->Next()) {
      const std::string name = a->NameTStr();
      if (read.attributes.contains(name) || DeclaresNamespace(name)) continue;
      Say(owner, "<" + element.ValueStr() + " " + name + "> is not read");
    }
    for (const TiXmlNode* node = element.FirstChild(); node != nullptr; node = node->NextSibling()) {
      if (const TiXmlText* text = node->ToText()) {
        Say(owner, "<" + element.ValueStr() + ">: the text " + Quoted(text->ValueStr()) + " is not read");
      } else if (const TiXmlElement* child = node->ToElement()) {
        VisitChild(*child, element, read, owner);
      }
    }
  }

  void VisitChild(const TiXmlElement& child, const TiXmlElement& parent, const Read& read,
                  const std::string& owner) {
    const std::string& tag = child.ValueStr();
    if (!read.children.contains(tag)) {
      if (!IsSilent(tag)) Say(owner, Shown(child) + " is not read" + Home(tag, parent.ValueStr()));
    } else if (parent.ValueStr() == "robot") {
      const char* name = child.Attribute("name");
      const std::string label = tag + " " + Quoted(name == nullptr ? "" : name) + ": ";
      Visit(child, label);
      if (tag == "joint") VisitUnused(child, label);
    } else {
      Visit(child, owner);
    }
  }

  // "<safety_controller k_velocity k_position>", "<link 'hand'>".
  static std::string Shown(const TiXmlElement& element) {
    std::string shown = "<" + element.ValueStr();
    if (const char* name = element.Attribute("name")) return shown + " " + Quoted(name) + ">";
    for (const TiXmlAttribute* a = element.FirstAttribute(); a != nullptr; a = a->Next()) {
      shown += " " + a->NameTStr();
    }
    return shown + ">";
  }

  // Elements of joints whose type leaves them without a meaning.
  void VisitUnused(const TiXmlElement& joint, const std::string& owner) {
    const std::string type = joint.Attribute("type") == nullptr ? "" : joint.Attribute("type");
    if (type == "continuous") {
      const TiXmlElement* limit = joint.FirstChildElement("limit");
      if (limit == nullptr) return;
      for (const char* end : {"lower", "upper"}) {
        double value = 0.0;
        const char* text = limit->Attribute(end);
        if (text == nullptr || (ParseNumber(text, &value) == NumberText::kOk && value == 0.0)) continue;
        Say(owner, "<limit " + std::string(end) + "> is not used: a continuous joint turns without limits");
      }
    } else if (type == "fixed") {
      for (const char* tag : {"limit", "dynamics", "mimic"}) {
        const TiXmlElement* element = joint.FirstChildElement(tag);
        if (element == nullptr || AllNumbersAreZero(*element)) continue;
        Say(owner, "<" + std::string(tag) + "> is not used: the joint is fixed");
      }
    }
  }

  const std::string& source_;
  std::vector<std::string> lines_;
  std::set<std::string> said_;
};

}  // namespace

std::vector<std::string> UrdfLeftovers(const TiXmlElement& robot, const std::string& source_name) {
  return Search(source_name).Run(robot);
}

}  // namespace rg::model
