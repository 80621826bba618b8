// Start and goal of a trajectory, drawn from one uniform distribution so that the arm can make it.
//
// Joint by joint, (start, goal) is uniform on the square of the sampling range, given
//   |goal − start| ≤ reach_fraction · v_max · T ,
// so starts and goals have the same distribution. The range is the position limits moved in by a margin;
// joints without limits get home ± continuous_range. Poses whose end effector is lower than
// `min_height` are drawn again.
#pragma once

#include <Eigen/Core>
#include <limits>
#include <optional>
#include <string>

#include "common/base/rng.h"
#include "common/base/status.h"
#include "common/dynamics/dynamics.h"
#include "common/model/robot_model.h"
#include "services/trajectories/motion_limits.h"

namespace rg::trajectories {

struct SamplingOptions {
  double reach_fraction = 0.6;       // of v_max · T: leaves time to speed up and slow down
  double position_margin = 0.05;     // rad or m, inside the limits
  double continuous_range = 3.1415;  // rad either side of home, joints without limits
  Eigen::VectorXd home;              // n × 1 (the candle pose, say), or empty: zero
  // Narrows every joint to home ± this [rad or m], inside the limits. Needs `home`.
  double home_range = std::numeric_limits<double>::infinity();
  // Start velocity uniform in ± this share of v_max; 0 starts at rest.
  double start_velocity_fraction = 0.0;
  // Lowest height of the end effector above the root frame [m], at start, goal and half-way between.
  double min_height = -std::numeric_limits<double>::infinity();
  // One goal for all (n × 1, from inverse kinematics, say) instead of random ones; starts are uniform
  // within reach of it.
  Eigen::VectorXd goal;
  int max_attempts = 1000;  // for one pair
};

struct StartGoal {
  Eigen::VectorXd q, v;  // start
  Eigen::VectorXd goal;
};

class StartGoalSampler {
 public:
  // Refuses ranges that are empty or not finite, naming the joint.
  static Result<StartGoalSampler> Create(const model::RobotModel& model, const MotionLimits& limits,
                                         double duration_s, const SamplingOptions& options);

  // nullopt when max_attempts poses in a row were too low.
  std::optional<StartGoal> Draw(Rng& rng);

  // Sampling range, n × 1.
  const Eigen::VectorXd& lower() const { return lower_; }
  const Eigen::VectorXd& upper() const { return upper_; }
  const Eigen::VectorXd& reach() const { return reach_; }

 private:
  explicit StartGoalSampler(const model::RobotModel& model) : mechanism_(model) {}
  void DrawJoint(int i, Rng& rng, StartGoal* draw) const;
  bool HighEnough(const Eigen::VectorXd& q);

  SamplingOptions options_;
  dynamics::Mechanism mechanism_;
  dynamics::Workspace workspace_;
  model::Frame end_effector_;
  Eigen::VectorXd lower_, upper_, reach_, velocity_;
};

}  // namespace rg::trajectories
