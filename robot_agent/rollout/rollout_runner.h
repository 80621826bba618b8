// One rollout, from wherever the arm is to a recording in the spool.
//
//   connect -> start pose (position mode) -> settle -> torque mode -> control loop -> stop -> spool
//   ^          ^ an arm that was away before the controller's first torque: stopped, and again from here when
//   it |            is back, config.start_attempts times in all an arm, driver or master that is away
//   meanwhile: the same, without a stop
//
// Everything from the first motion on is watched by the safety monitor, with the agent's own limits and
// kinematics, and ends in StopArm; a stop that was not confirmed latches (safety/latch.h), and a latched arm
// does not move. A rollout begins with the first torque that its controller is asked for.
// Who calls it: the executor of the task kind `rollout`, a test, or a program; one thread. What is
// durable when it returns a result: the bundle, in the spool's ready folder under spec.id. A repeat with
// the same id moves nothing: the bundle that is there is returned, or, where it is gone, kAlreadyExists. An
// arm never begins a rollout twice, whatever was lost in between (Spool::MarkBegun). How a rollout ended that
// began is a result with its reason; an error means that it did not begin (unreachable, wrong joints, start
// pose not reached, torque mode refused) and may be asked for again, or that the recording could not be kept.
// What was recorded of one that did not begin is kept beside it, with its reason (Spool::CommitNotBegun).
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "common/base/clock.h"
#include "common/base/progress.h"
#include "common/sim/plant.h"
#include "robot_agent/agent_config.h"
#include "robot_agent/control_loop.h"
#include "robot_agent/rollout/rollout_bundle.h"
#include "robot_agent/spool.h"
#include "services/rollouts/rollout_spec.h"
#include "services/rollouts/scoring.h"

namespace rg::robot_agent {

class GuardDriver;

// Limits and poses of the configuration as what algorithms take.
Eigen::VectorXd ToEigen(const std::vector<double>& x);

struct RolloutPlan {
  rollouts::RolloutSpec spec;  // start and goal filled in
  SafetyLimits limits;
  double trust = 1.0;
  double speed = 1.0;  // share of the full speed; less where a rollout is made again
};
// Start (the agent's if the spec has none), limits, goal: given, by inverse kinematics, or sampled by
// goal_seed. Depends on nothing but its arguments. The goal lies inside the position box. With less than full
// `trust` (services/rollouts/trust.h) the rollout is shorter, its velocity limits and the reach of a drawn
// goal are smaller.
Result<RolloutPlan> PlanRollout(const rollouts::RolloutSpec& spec, const AgentConfig& config,
                                const sim::Plant& plant, double trust = 1.0);

struct RolloutInput {
  const RolloutPlan& plan;
  const AgentConfig& config;
  const sim::Plant& plant;   // the believed model: joints, URDF and gravity for the recording
  Controller& controller;    // for plan.spec.goal
  bool limit_speed = false;  // commands are kept from the velocity limits (limited_controller.h)
  std::vector<std::string> made_again = {};  // how the rollouts ended that this one is made again for
  LoopObserver* observer = nullptr;
  const GuardDriver* guard = nullptr;  // the driver, if it is one
  std::string controller_name = "policy";
  // Into the metadata: the recording's lineage.
  std::string policy_sha256 = {}, model_sha256 = {}, database = {}, job_id = {}, task_id = {};
};

struct RolloutResult {
  std::string bundle;       // bytes of the tar
  std::string bundle_path;  // in the spool
  EndReason reason = EndReason::kNone;
  std::string detail;
  int rows = 0;  // of the recording; 0 and 1: nothing that can be used
  bool usable() const { return rows >= 2; }
  rollouts::GoalError goal_error;  // if rows > 0
  JitterReport jitter;             // empty if the bundle was there already
  std::string rollout_json;
  bool was_there = false;
};

Result<RolloutResult> RunRollout(Driver& driver, const RolloutInput& input, Spool& spool,
                                 const ProgressFn& progress, const CancelToken& stop, const Clock& clock);

}  // namespace rg::robot_agent
