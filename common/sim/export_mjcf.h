// A plant with its values as MJCF, MuJoCo's format.
//
//   <option gravity>           gravity in the base frame, a tilted base included
//   <body><inertial>           every link with its mass, com and full inertia; a payload is added to the last
//   <joint>                    damping: declared + viscous_friction; frictionloss: declared + the Coulomb
//                              level of the friction effects; armature: rotor_inertia; stiffness and
//                              springref: the linear part of position_spring; range: position limits
//   <actuator><general>        ctrl is the commanded torque. gainprm: force_gain · torque_gain;
//                              dyntype filterexact with dynprm: actuator_lag; ctrlrange: torque_saturation
//                              (before the lag, as in the plant); forcerange: the effort limit
// Joints that the model locks are fixed where it locks them. Links are bodies under their own names,
// joints and actuators under the joint's name; a root link called world is MuJoCo's own. Shapes (visuals,
// collisions) are left out. What MJCF has no place for is in `left_out`, one line each.
#pragma once

#include <Eigen/Core>

#include "common/base/status.h"
#include "common/sim/export_urdf.h"
#include "common/sim/plant.h"

namespace rg::sim {

// values: plant.parameters().size(). step_s: <option timestep>. Errors as ExportUrdf.
Result<ExportedModel> ExportMjcf(const Plant& plant, const Eigen::VectorXd& values, double step_s = 0.001);

}  // namespace rg::sim
