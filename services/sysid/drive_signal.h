// The effort of a recording as the simulator takes it, and the rigid-body view of a plant's parameters.
#pragma once

#include <Eigen/Core>

#include "common/dynamics/dynamics.h"
#include "common/recordings/recording.h"
#include "common/sim/command_signal.h"
#include "common/sim/plant.h"

namespace rg::sysid {

// The drive effort of a recording: commands hold to the next row, measured efforts are linear between
// rows. RG_CHECKs that the recording has an effort (its loader holds that). Prescribed joints move as
// measured, smoothed within the sensor's noise.
sim::CommandSignal DriveSignal(const recordings::Recording& recording);

// The same for a drive that adds its own gravity compensation to the effort in the file: the torque
// that holds the arm of `drive_values` (of the plant's table) at the *measured* positions is added, for
// held commands at the mean position of the interval. For fitting; a prediction takes the simulated
// position instead, since the measured one is what it predicts.
sim::CommandSignal DriveSignalWithGravity(const recordings::Recording& recording, const sim::Plant& plant,
                                          const Eigen::VectorXd& drive_values);

// 10 × num_links, columns as RobotModel::links, from the plant's parameter values.
dynamics::LinkParametersMatrix LinkParametersOf(const sim::Plant& plant, const Eigen::VectorXd& values);
Eigen::Vector3d GravityOf(const sim::Plant& plant, const Eigen::VectorXd& values);
// The rigid bodies of the plant at these values, without effects.
dynamics::Mechanism MechanismOf(const sim::Plant& plant, const Eigen::VectorXd& values);

}  // namespace rg::sysid
