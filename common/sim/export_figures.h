// What a plant with values says of its links and joints, gathered for the formats of other tools.
// Private to this folder.
#pragma once

#include <Eigen/Core>
#include <limits>
#include <string>
#include <vector>

#include "common/model/robot_model.h"
#include "common/sim/plant.h"

namespace rg::sim::internal {

// Sums over everything that acts on a joint; the defaults do nothing.
struct JointFigures {
  double damping = 0;     // N·m·s/rad: declared, viscous_friction
  double friction = 0;    // N·m: declared, the Coulomb level of every friction effect
  double armature = 0;    // kg·m²: rotor_inertia
  double gain = 1;        // delivered per commanded torque: force_gain · torque_gain
  double lag_s = 0;       // actuator_lag
  double stiffness = 0;   // N·m/rad: position_spring
  double spring_ref = 0;  // rad
  double torque_limit = std::numeric_limits<double>::infinity();  // N·m: torque_saturation
};

struct ExportFigures {
  // 10 × links as RobotModel::links(), a payload added to the link that holds it.
  Eigen::Matrix<double, model::kLinkParameters, Eigen::Dynamic> links;
  Eigen::Vector3d gravity;  // m/s² in the base frame, a tilted base included
  std::vector<JointFigures> joints;
};

// What a format has a place for, effect by effect: what stays out, as the rest of a sentence about
// the effect; null where nothing does.
struct Coverage {
  const char* effect;
  const char* left_out;
};

ExportFigures FiguresOf(const Plant& plant, const Eigen::VectorXd& values);

// One line per effect that is not wholly covered: "joint_elasticity (joint_2, joint_3): no place in
// URDF; left out". Effects whose figures are all zero say nothing.
std::vector<std::string> LeftOut(const Plant& plant, const Eigen::VectorXd& values, const char* format,
                                 const std::vector<Coverage>& covered);

// Refuses what no engine loads: values that are not finite, a moving body's negative mass.
Status CheckExportable(const Plant& plant, const ExportFigures& figures);

// Shortest text that reads back as the same double.
std::string ExactNumber(double value);

}  // namespace rg::sim::internal
