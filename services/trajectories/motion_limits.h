// What bounds a motion: torque, speed and position of each joint.
#pragma once

#include <Eigen/Core>

#include "common/model/robot_model.h"

namespace rg::trajectories {

// Bounds of a motion, n × 1 each. ±infinity where there is none.
struct MotionLimits {
  Eigen::VectorXd torque;          // |u|
  Eigen::VectorXd velocity;        // |v|
  Eigen::VectorXd position_lower;  // q
  Eigen::VectorXd position_upper;

  // The model's own limits; torque also at most `peak_torque` (n × 1, or empty).
  static MotionLimits FromModel(const model::RobotModel& model, const Eigen::VectorXd& peak_torque = {});
  // Position moved inwards by `position` [rad or m], velocity by the share `velocity`.
  MotionLimits Tightened(double position, double velocity) const;
};

// Peak torques of the actuators where the robot is one whose data sheet is known (the Mico²: 30.5 N·m
// large, 6.8 N·m small); empty for other robots.
Eigen::VectorXd KnownPeakTorques(const model::RobotModel& model);

}  // namespace rg::trajectories
