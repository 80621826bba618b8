// What stands beside one robot: its driver, its arm, its boxes, its start pose. The fence (limits,
// kinematics, gravity) comes from here and from nowhere else; see docs/safety.md.
//
// realitygrad.agent/1, JSON: "format", "name" ("mico2": the worker's tag robot:<name>), "driver"
// ("simulated" | "kinova" | "replay"), "kinova" {} (drivers/kinova/kinova_options.h), "replay" {"set":
// folder, relative, "recording": its name, default the first, "lock_step"}, "simulated" {"truth": path
// relative to this file, "lock_step": bool, "socket": path of a robot started by hand}, "urdf" (path relative
// to this file), "joints" (those that move; absent: all), "locked" {joint: q}, "end_effector" (a link;
// absent: the URDF's), "gravity" [3] (absent: 0, 0, -9.81), "start_pose" [n], "pose_tolerance",
// "pose_timeout_s", "start_attempts" (how often an arm that was away before the first torque of a rollout is
// connected to or prepared; 3), "limits" (see safety/limits.h; each has to be there), "max_rate_hz", "max_duration_s" (of
// a rollout), "velocity_source" ("measured" | "differenced": what the controller gets), "excitation" (share
// of the torque limits, see RolloutSpec), "min_free_mb" (of the spool's disk).
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "common/model/robot_model.h"
#include "robot_agent/control_loop.h"
#include "robot_agent/drivers/driver.h"
#include "robot_agent/drivers/driver_registry.h"
#include "robot_agent/drivers/kinova/kinova_options.h"
#include "robot_agent/drivers/replay/replay_driver.h"
#include "robot_agent/drivers/simulated_driver.h"
#include "robot_agent/safety/capsules.h"
#include "robot_agent/safety/limits.h"
#include "services/rollouts/trust.h"

namespace rg::robot_agent {

struct AgentConfig {
  std::string name;
  std::string driver = "simulated";
  SimulatedDriverOptions simulated;
  kinova::KinovaOptions kinova;
  ReplayOptions replay;
  DriverRequest own;  // for a driver of drivers/driver_registry.h
  std::vector<double> start_pose;
  double pose_tolerance = 0.05;  // rad (m), per joint
  double pose_timeout_s = 60.0;
  double settle_s = 0.3;  // at rest in the start pose before torque mode
  double connect_timeout_s = 10.0;
  int start_attempts = 3;  // 1 to 10
  StopOptions stop;        // not of the file
  std::shared_ptr<const model::RobotModel> arm;  // of "urdf"
  std::vector<double> gravity = {0.0, 0.0, -9.81};
  CapsuleSet parts;
  SafetyLimits limits;            // validated
  double max_rate_hz = 1000.0;    // of a rollout's control cycle
  double max_duration_s = 600.0;  // of a rollout
  double min_free_mb = 64.0;      // a rollout does not begin with less on the spool's disk
  VelocitySource velocity_source = VelocitySource::kMeasured;
  // The arm is a child process of its driver: with the driver gone there is none that could move.
  bool arm_ends_with_driver() const { return driver == "simulated" && simulated.socket_path.empty(); }
  std::string path;         // of the file; empty: none
  bool dry_run = false;     // not of the file: --dry-run
  double arm_timeout_s = 0.0;  // not of the file: --arm-timeout
  // Short and slow at first. "first_rollouts": {"duration_s": 2, "speed": 0.4} or null; where it is not said, this
  // for an arm that is neither simulated nor replayed.
  rollouts::FirstRollouts first_rollouts;
  double excitation = 0.0;  // where the rollout's specification leaves it open
};

// `folder` resolves relative paths; `source` names the text in errors.
Result<AgentConfig> ParseAgentConfig(const std::string& json, const std::string& folder,
                                     const std::string& source);
Result<AgentConfig> LoadAgentConfig(const std::string& path);

// The agent's limits, made tighter by what a job's model says: its position limits less 0.02, its effort
// limits. Never wider, whatever the model says. Checked with the start pose (`start`, n).
Result<SafetyLimits> LimitsFor(const AgentConfig& config, const model::RobotModel& model,
                               const std::vector<double>& start);

// `robot_seed`: a simulated robot's sensor noise.
Result<std::unique_ptr<Driver>> MakeDriver(const AgentConfig& config, uint64_t robot_seed);

}  // namespace rg::robot_agent
