// Joints whose links have no inertia about their axis (model::RobotModel::joints_without_inertia) move by the
// inertia of their drive's rotor alone, which no URDF tells: a parameter of every calibration, and one
// without which nothing can be simulated.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "common/recordings/recording_set.h"
#include "common/sim/plant.h"

namespace rg::sysid {

// Whether the plant can be simulated at these values: every such rotor inertia is positive, but for
// those of prescribed joints.
bool Runs(const sim::Plant& plant, const Eigen::VectorXd& values);
// The joints that keep it from it.
std::vector<std::string> JointsThatDoNotRun(const sim::Plant& plant, const Eigen::VectorXd& values);

// The plant with rotor inertias to start from as nominal values: those of `values`, else an estimate from the
// efforts of the recordings to fit, less what the rigid bodies need. The estimate is kept within a few
// decades of the least inertia that another joint carries.
Result<sim::Plant> WithRotors(const recordings::RecordingSet& set, const sim::Plant& plant,
                              const Eigen::VectorXd& values);

// "flange_joint's rotor inertia is a calibration parameter, 0.0032 kg*m^2: …"; one line per such joint.
std::vector<std::string> NotesOnRotors(const sim::Plant& plant, const Eigen::VectorXd& values);

}  // namespace rg::sysid
