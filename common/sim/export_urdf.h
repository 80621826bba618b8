// A plant with its values as a URDF that other tools load.
//
// The text the model was loaded from, everything kept (visuals, collisions, fixed and locked joints,
// comments), but for what was identified:
//   <inertial> of every link      mass, com, inertia about the com in link axes; a payload is added to the
//                                 last link; links without inertial get one only if they have values now
//   <dynamics damping friction>   of every moving joint: declared damping + viscous_friction; declared
//                                 friction + the Coulomb level of coulomb_, stribeck_, asymmetric_friction
//   <limit effort>                where torque_saturation is lower
// Loaded back with the same joints it has the same rigid-body dynamics, damping and friction. Gravity, force
// gains and the other effects have no place in a URDF: `left_out` says so, one line each.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "common/sim/plant.h"

namespace rg::sim {

struct ExportedModel {
  std::string text;
  std::vector<std::string> left_out;
};

// values: plant.parameters().size(). Error: values that a URDF may not hold (a negative mass, not finite).
Result<ExportedModel> ExportUrdf(const Plant& plant, const Eigen::VectorXd& values);

}  // namespace rg::sim
