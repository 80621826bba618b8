// What a rollout is to be: where it starts, where it should go, for how long.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <string>

#include "common/base/rng.h"
#include "common/base/status.h"
#include "common/model/robot_model.h"

namespace rg::rollouts {

struct RolloutSpec {
  // Also the name of the recording and its identity when it is delivered twice
  // (robot_agent/rollout/rollout_task_kind.cc).
  std::string id;
  double rate_hz = 25.0;
  double duration_s = 6.0;
  Eigen::VectorXd start;  // n, the candle pose; empty: the agent's own
  // The goal: these joints (n) if given, else this place of the end effector (3, m, base frame) if
  // given, else a random one (SampleGoal with the fields below).
  Eigen::VectorXd goal;
  Eigen::VectorXd goal_position;
  uint64_t goal_seed = 1;
  double goal_reach_s = 1.0;  // > 0: |goal - start| ≤ 0.6 · v_max · goal_reach_s
  // Small known torques on top of the controller's, as a share of each joint's torque limit, faded out
  // before the end; negative: what the agent's configuration says.
  double excitation = -1.0;
  uint64_t robot_seed = 1;  // of a simulated robot's sensor noise
};

// Plain id (80 letters, digits, '-', '_', '.'; it becomes the name of files), rate 1 to 1000 Hz, duration 0.1
// to 600 s, finite numbers.
Status CheckSpec(const RolloutSpec& spec);

// Uniform in the box |q - start| ≤ 0.6 · v_max · reach_s cut by the position limits less a margin:
// [lower, upper] (n each) is the safety box, so that a goal never asks to leave it. At least one joint
// moves by half of what it may (redrawn until then), so that no goal is the start.
Eigen::VectorXd SampleGoal(const model::RobotModel& model, const Eigen::VectorXd& start,
                           const Eigen::VectorXd& lower, const Eigen::VectorXd& upper, double reach_s,
                           Rng& rng);

}  // namespace rg::rollouts
