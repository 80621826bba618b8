// The points of a robot that touch what stands around it, and their recorded motion.
#pragma once

#include <Eigen/Core>
#include <array>
#include <string>
#include <vector>

#include "common/dynamics/dynamics.h"
#include "common/model/robot_model.h"

namespace rg::diagnosis {

struct TouchingPoint {
  model::Frame frame;
  std::string option;  // "point" of the effects that act there; empty: the default
};
// The end effector, and the last link where that is elsewhere.
std::vector<TouchingPoint> TouchingPoints(const model::RobotModel& model);

// In the base's frame.
struct PointMotion {
  Eigen::MatrixXd position;                 // 3 × rows, m
  std::array<Eigen::MatrixXd, 3> jacobian;  // of x, y, z: n × rows
};
// q: n × rows.
PointMotion MotionOf(const TouchingPoint& point, const model::RobotModel& model, const Eigen::MatrixXd& q);

}  // namespace rg::diagnosis
