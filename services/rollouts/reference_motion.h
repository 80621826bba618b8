// A motion that the robot is to make: positions over time, for recordings that tell rivals apart.
//
// CSV as a recording's: time, position.<joint>…, and velocity.<joint>… where they are known (else slopes
// of the positions); SI units. Other columns are left alone, so that a recording is a motion, too. It begins
// at rest. Between rows it is the cubic through positions and velocities.
#pragma once

#include <Eigen/Core>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.h"
#include "common/model/robot_model.h"

namespace rg::rollouts {

struct ReferenceMotion {
  std::vector<std::string> joints;  // n, in model order
  Eigen::VectorXd t;                // K ≥ 2, s, increasing from 0
  Eigen::MatrixXd q, v;             // n × K

  double duration_s() const { return t[t.size() - 1]; }
  // At a time; before the first row and after the last one it rests there. n each.
  void At(double time, Eigen::VectorXd* q_at, Eigen::VectorXd* v_at, Eigen::VectorXd* a_at) const;
};

// One line for everything that is wrong with the text: it names row, column and value.
Result<ReferenceMotion> ParseMotion(std::string_view csv, const std::string& source,
                                    const model::RobotModel& robot);

// The bounds a motion has to keep, n each: rad or m, rad/s or m/s.
struct MotionBounds {
  Eigen::VectorXd lower, upper, velocity;
};
// The line names joint, time, value and limit; also where it does not begin at rest, leaves gaps of more than
// 0.25 s, or is longer than 600 s.
Status CheckMotion(const ReferenceMotion& motion, const MotionBounds& bounds);

}  // namespace rg::rollouts
