#include "common/sim/export_figures.h"

#include <charconv>
#include <cmath>

#include "common/base/check.h"
#include "common/effects/effect_catalog.h"
#include "common/sim/parameter_values.h"

namespace rg::sim::internal {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using Eigen::VectorXd;

double ValueOf(const Plant& plant, const VectorXd& values, const std::string& name) {
  const int index = plant.parameters().Find(name);
  RG_CHECK(index >= 0) << name;
  return values[index];
}

// A point mass m at r joins a link: new mass, com, and inertia about the new com.
void AddPointMass(double m, const Vector3d& r, model::LinkParameters* link) {
  const double before = (*link)[0], mass = before + m;
  if (mass == 0) return;
  const Vector3d com = link->segment<3>(1);
  const Vector3d d = r - com;
  const Matrix3d turn = before * m / mass * (d.squaredNorm() * Matrix3d::Identity() - d * d.transpose());
  (*link)[0] = mass;
  link->segment<3>(1) = (before * com + m * r) / mass;
  (*link)[4] += turn(0, 0), (*link)[5] += turn(1, 1), (*link)[6] += turn(2, 2);
  (*link)[7] += turn(0, 1), (*link)[8] += turn(0, 2), (*link)[9] += turn(1, 2);
}

void TakeLinks(const Plant& plant, const VectorXd& values, ExportFigures* out) {
  const model::RobotModel& robot = plant.model();
  out->links.resize(model::kLinkParameters, robot.num_links());
  for (int l = 0; l < robot.num_links(); ++l) {
    for (int i = 0; i < model::kLinkParameters; ++i) {
      out->links(i, l) =
          ValueOf(plant, values,
                  std::string(model::kLinkParameterNames[static_cast<size_t>(i)]) + "." + robot.link(l).name);
    }
  }
}

// What `effect` adds to the figures of `joint`.
void TakeJointEffect(const Plant& plant, const VectorXd& values, const std::string& effect,
                     const std::string& joint, JointFigures* out) {
  const auto get = [&](const char* parameter) {
    return ValueOf(plant, values, effect + "." + joint + "." + parameter);
  };
  if (effect == "viscous_friction") {
    out->damping += get("viscous");
  } else if (effect == "coulomb_friction" || effect == "stribeck_friction" ||
             effect == "presliding_hysteresis") {
    out->friction += get("coulomb");
  } else if (effect == "asymmetric_friction") {
    out->friction += 0.5 * (get("coulomb_positive") + get("coulomb_negative"));
  } else if (effect == "rotor_inertia") {
    out->armature += get("armature");
  } else if (effect == "torque_gain") {
    out->gain *= get("gain");
  } else if (effect == "actuator_lag") {
    out->lag_s = get("time_constant");
  } else if (effect == "position_spring") {
    out->stiffness = get("stiffness"), out->spring_ref = get("center");
  } else if (effect == "torque_saturation") {
    out->torque_limit = get("limit");
  }
}

void TakePayload(const Plant& plant, const VectorXd& values, ExportFigures* out) {
  const auto get = [&](const char* p) { return ValueOf(plant, values, std::string("payload.*.") + p); };
  const model::RobotModel& robot = plant.model();
  model::LinkParameters link = out->links.col(robot.joints().back().child_link);
  AddPointMass(get("mass"), {get("com_x"), get("com_y"), get("com_z")}, &link);
  out->links.col(robot.joints().back().child_link) = link;
}

bool DoesNothing(const Plant& plant, const VectorXd& values, const effects::EffectSpec& spec) {
  for (int i = 0; i < plant.parameters().size(); ++i) {
    const Parameter& row = plant.parameters()[i];
    if (row.effect == spec.id && values[i] != 0) return false;
  }
  return true;
}

std::string JointList(const effects::EffectSpec& spec) {
  std::string list;
  for (const std::string& joint : spec.joints) list += (list.empty() ? " (" : ", ") + joint;
  return list.empty() ? list : list + ")";
}

}  // namespace

ExportFigures FiguresOf(const Plant& plant, const VectorXd& values) {
  RG_CHECK(values.size() == plant.parameters().size());
  ExportFigures out;
  ParameterValues effective(plant.data());
  effective.Set(values);
  out.gravity = effective.gravity();
  TakeLinks(plant, values, &out);
  out.joints.resize(static_cast<size_t>(plant.num_joints()));
  for (int j = 0; j < plant.num_joints(); ++j) {
    const std::string& name = plant.joint_names()[static_cast<size_t>(j)];
    JointFigures& joint = out.joints[static_cast<size_t>(j)];
    joint.damping = ValueOf(plant, values, "damping." + name);
    joint.friction = ValueOf(plant, values, "friction." + name);
    if (const int rotor = plant.parameters().Find("armature." + name); rotor >= 0)
      joint.armature = values[rotor];
    joint.gain = ValueOf(plant, values, "force_gain." + name);
    for (const effects::EffectSpec& spec : plant.effects()) {
      for (const std::string& at : spec.joints) {
        if (at == name) TakeJointEffect(plant, values, spec.id, name, &joint);
      }
    }
  }
  for (const effects::EffectSpec& spec : plant.effects()) {
    if (spec.id == "payload") TakePayload(plant, values, &out);
  }
  return out;
}

std::vector<std::string> LeftOut(const Plant& plant, const VectorXd& values, const char* format,
                                 const std::vector<Coverage>& covered) {
  std::vector<std::string> lines;
  for (const effects::EffectSpec& spec : plant.effects()) {
    if (DoesNothing(plant, values, spec)) continue;
    std::string left_out = std::string("no place in ") + format + "; left out";
    for (const Coverage& row : covered) {
      if (spec.id == row.effect) left_out = row.left_out != nullptr ? row.left_out : "";
    }
    if (!left_out.empty()) lines.push_back(spec.id + JointList(spec) + ": " + left_out);
  }
  return lines;
}

Status CheckExportable(const Plant& plant, const ExportFigures& figures) {
  const model::RobotModel& robot = plant.model();
  if (!figures.gravity.allFinite()) return InvalidError("gravity is not finite: nothing to export");
  for (int l = 0; l < robot.num_links(); ++l) {
    const auto link = figures.links.col(l);
    if (!link.allFinite()) return InvalidError("link " + robot.link(l).name + ": a value is not finite");
    if (link[0] < 0) {
      return InvalidError("mass." + robot.link(l).name + " is " + ExactNumber(link[0]) +
                          " kg: no engine loads a negative mass; identify with bounds before exporting");
    }
  }
  for (int j = 0; j < plant.num_joints(); ++j) {
    const JointFigures& joint = figures.joints[static_cast<size_t>(j)];
    for (const double value : {joint.damping, joint.friction, joint.armature, joint.gain, joint.lag_s,
                               joint.stiffness, joint.spring_ref}) {
      if (!std::isfinite(value))
        return InvalidError("joint " + plant.joint_names()[static_cast<size_t>(j)] +
                            ": a value is not finite");
    }
  }
  return Status::Ok();
}

std::string ExactNumber(double value) {
  char text[40];
  const auto [end, error] = std::to_chars(text, text + sizeof text, value);
  RG_CHECK(error == std::errc());
  return {text, end};
}

}  // namespace rg::sim::internal
