#include "common/sim/export_urdf.h"

#include <tinyxml.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <string_view>

#include "common/base/check.h"
#include "common/base/number_text.h"
#include "common/sim/export_figures.h"

namespace rg::sim {
namespace {

using Eigen::VectorXd;
using internal::ExactNumber;
using internal::ExportFigures;
using internal::JointFigures;

const std::vector<internal::Coverage>& UrdfCovers() {
  static const std::vector<internal::Coverage> rows = {
      {"viscous_friction", nullptr},
      {"coulomb_friction", nullptr},
      {"torque_saturation", nullptr},
      {"payload", nullptr},
      {"stribeck_friction", "only its Coulomb level is in <dynamics friction>, not the peak at rest"},
      {"asymmetric_friction", "the mean of both directions is in <dynamics friction>"},
      {"presliding_hysteresis", "only its Coulomb level is in <dynamics friction>, not the bristles"}};
  return rows;
}

// The child `name`, made if it is not there.
TiXmlElement* Child(TiXmlElement* parent, const char* name) {
  if (TiXmlElement* child = parent->FirstChildElement(name)) return child;
  return parent->InsertEndChild(TiXmlElement(name))->ToElement();
}

void Set(TiXmlElement* element, const char* attribute, double value) {
  element->SetAttribute(attribute, ExactNumber(value));
}

constexpr const char* kNumeric[] = {"xyz",   "rpy",   "value",  "ixx",      "ixy",     "ixz",      "iyy",        "iyz",   "izz",
                                   "lower", "upper", "effort", "velocity", "damping", "friction", "multiplier", "offset"};

// Numbers as every reader takes them: some lose a whole element over a sign, a tab or a point without a digit. What is
// no list of numbers stays as it is.
void SpellPlainly(TiXmlElement* element) {
  for (const char* attribute : kNumeric) {
    const char* text = element->Attribute(attribute);
    if (text == nullptr) continue;
    constexpr std::string_view kBlank = " \t\r\n";
    std::string plain;
    bool numbers = true;
    for (std::string_view rest(text); numbers;) {
      rest.remove_prefix(std::min(rest.find_first_not_of(kBlank), rest.size()));
      if (rest.empty()) break;
      const std::string_view word = rest.substr(0, rest.find_first_of(kBlank));
      double value = 0;
      numbers = ParseNumber(word, &value) == NumberText::kOk;
      plain += (plain.empty() ? "" : " ") + ExactNumber(value);
      rest.remove_prefix(word.size());
    }
    if (numbers && !plain.empty()) element->SetAttribute(attribute, plain);
  }
  for (TiXmlElement* e = element->FirstChildElement(); e != nullptr; e = e->NextSiblingElement()) SpellPlainly(e);
}

void WriteInertial(const Eigen::Ref<const VectorXd>& p, bool had_inertial, TiXmlElement* link) {
  if (!had_inertial && p.isZero(0)) return;
  TiXmlElement* inertial = Child(link, "inertial");
  TiXmlElement* origin = Child(inertial, "origin");
  origin->SetAttribute("xyz", ExactNumber(p[1]) + " " + ExactNumber(p[2]) + " " + ExactNumber(p[3]));
  origin->SetAttribute("rpy", "0 0 0");
  origin->RemoveAttribute("quat_xyzw");  // the inertia is given along the link's axes
  Set(Child(inertial, "mass"), "value", p[0]);
  TiXmlElement* inertia = Child(inertial, "inertia");
  const char* const names[] = {"ixx", "iyy", "izz", "ixy", "ixz", "iyz"};
  for (int i = 0; i < 6; ++i) Set(inertia, names[i], p[4 + i]);
}

void WriteJoint(const JointFigures& figures, double declared_effort, TiXmlElement* joint) {
  TiXmlElement* dynamics = joint->FirstChildElement("dynamics");
  if (dynamics != nullptr || figures.damping != 0 || figures.friction != 0) {
    dynamics = Child(joint, "dynamics");
    Set(dynamics, "damping", figures.damping);
    Set(dynamics, "friction", figures.friction);
  }
  TiXmlElement* limit = joint->FirstChildElement("limit");
  if (limit != nullptr && figures.torque_limit < declared_effort) Set(limit, "effort", figures.torque_limit);
}

void WriteRobot(const Plant& plant, const ExportFigures& figures, TiXmlElement* robot) {
  for (TiXmlElement* e = robot->FirstChildElement(); e != nullptr; e = e->NextSiblingElement()) {
    const char* name = e->Attribute("name");
    if (name == nullptr) continue;
    if (e->ValueStr() == "link") {
      const int l = plant.model().FindLink(name);
      RG_CHECK(l >= 0) << name;
      WriteInertial(figures.links.col(l), plant.model().link(l).has_inertial, e);
    } else if (const int j = e->ValueStr() == "joint" ? plant.model().FindJoint(name) : -1; j >= 0) {
      WriteJoint(figures.joints[static_cast<size_t>(j)], plant.model().joint(j).effort, e);
    }
  }
}

// What the parameters (not the effects) say that a URDF cannot.
void NoteParameters(const Plant& plant, const VectorXd& values, const ExportFigures& figures,
                    std::vector<std::string>* left_out) {
  if (figures.gravity != Eigen::Vector3d(0, 0, -9.81)) {
    left_out->push_back("gravity (" + ExactNumber(figures.gravity[0]) + ", " +
                        ExactNumber(figures.gravity[1]) + ", " + ExactNumber(figures.gravity[2]) +
                        ") m/s²: no place in URDF; set it in the simulator that loads it");
  }
  for (const int i : plant.parameters().OfKind(ParameterKind::kArmature)) {
    if (values[i] != 0)
      left_out->push_back(plant.parameters()[i].name + " " + ExactNumber(values[i]) + " " + plant.parameters()[i].unit +
                          ": no place in URDF; give it to the simulator that loads it");
  }
  std::string gains;
  for (const std::string& joint : plant.joint_names()) {
    const double gain = values[plant.parameters().Find("force_gain." + joint)];
    if (gain != 1) gains += (gains.empty() ? "" : ", ") + joint + " " + ExactNumber(gain);
  }
  if (!gains.empty())
    left_out->push_back("force_gain (" + gains + "): no place in URDF; multiply the commanded torque by it");
  for (const auto& [joint, position] : plant.model().locked()) {
    left_out->push_back("joint " + joint + ": locked at " + ExactNumber(position) +
                        " in the model, moves in the URDF");
  }
}

}  // namespace

Result<ExportedModel> ExportUrdf(const Plant& plant, const VectorXd& values) {
  const ExportFigures figures = internal::FiguresOf(plant, values);
  RG_RETURN_IF_ERROR(internal::CheckExportable(plant, figures));
  TiXmlDocument document;
  document.Parse(plant.model().urdf_text().c_str());
  if (document.Error() || document.RootElement() == nullptr)
    return InternalError("the model's URDF text is not well-formed XML: " +
                         std::string(document.ErrorDesc()));
  for (TiXmlElement* e = document.RootElement()->FirstChildElement(); e != nullptr; e = e->NextSiblingElement()) {
    if (e->ValueStr() == "link" || e->ValueStr() == "joint") SpellPlainly(e);
  }
  WriteRobot(plant, figures, document.RootElement());
  TiXmlPrinter printer;
  printer.SetIndent("  ");
  document.Accept(&printer);
  ExportedModel out;
  out.text = printer.Str();
  NoteParameters(plant, values, figures, &out.left_out);
  for (std::string& line : internal::LeftOut(plant, values, "URDF", UrdfCovers()))
    out.left_out.push_back(std::move(line));
  return out;
}

}  // namespace rg::sim
