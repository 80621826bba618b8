// Joint positions for a goal in task space.
//
// Levenberg-Marquardt on the pose error of a frame, joint limits held at every iterate (a joint that
// the step would push outwards through its limit is left out of it), restarted from random
// postures. The error is (p_goal − p; ½ Σ r_i × r_i,goal for the orientation), Jacobian of the frame's
// origin. Several solutions: the one nearest to `near` wins.
// Ref: Nakamura & Hanafusa, J. Dyn. Sys. Meas. Control 108(3), 1986 (damping); Siciliano et al.,
// Robotics, section 3.7.3 (orientation error).
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>

#include "common/base/rng.h"
#include "common/model/robot_model.h"

namespace rg::trajectories {

struct TaskGoal {
  Eigen::Vector3d position;                    // m, root frame
  std::optional<Eigen::Matrix3d> orientation;  // R_WF, or any
  std::string link;                            // empty: the model's end effector
};

struct IkOptions {
  double position_tolerance = 1e-4;     // m
  double orientation_tolerance = 1e-3;  // rad
  int max_iterations = 150;             // of one start
  int max_starts = 60;
  int solutions = 8;                 // stop after so many, the nearest to `near` is returned
  double position_margin = 0.05;     // rad or m, inside the joint limits
  double continuous_range = 3.1415;  // restarts of joints without limits: near ± this
};

struct IkResult {
  bool reached = false;
  Eigen::VectorXd q;               // n; the best found when not reached
  double position_error = 0.0;     // m
  double orientation_error = 0.0;  // rad; 0 when any will do
  int starts = 0;
  int solutions = 0;
  // "link end_effector: 0.213 m and 0 rad short of (1.2, 0, 0.4) after 60 starts"; empty when reached
  std::string message;
};

// `near` (n): the first start, and what solutions are compared with. Unknown links say so in `message`.
IkResult SolveInverseKinematics(const model::RobotModel& model, const TaskGoal& goal,
                                const Eigen::VectorXd& near, const IkOptions& options, Rng& rng);

}  // namespace rg::trajectories
