// What stands beside one robot: its driver, its boxes, its start pose.
//
// realitygrad.agent/1, JSON: "format", "name" ("mico2": the worker's tag robot:<name>), "driver"
// ("simulated" | "kinova" | "replay"), "kinova" {} (drivers/kinova/kinova_options.h), "replay" {"set":
// folder, relative, "recording": its name, default the first, "lock_step"}, "simulated" {"truth": path
// relative to this file, "lock_step": bool, "socket": path of a robot started by hand}, "start_pose" [n],
// "pose_tolerance", "pose_timeout_s", "limits" (see safety/limits.h; what is absent comes from the model),
// "velocity_source" ("measured" | "differenced"), "excitation" (share of the torque limits, see RolloutSpec).
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "common/model/robot_model.h"
#include "robot_agent/control_loop.h"
#include "robot_agent/drivers/driver.h"
#include "robot_agent/drivers/kinova/kinova_options.h"
#include "robot_agent/drivers/replay/replay_driver.h"
#include "robot_agent/drivers/simulated_driver.h"
#include "robot_agent/safety/limits.h"

namespace rg::robot_agent {

struct AgentConfig {
  std::string name;
  std::string driver = "simulated";
  SimulatedDriverOptions simulated;
  kinova::KinovaOptions kinova;
  ReplayOptions replay;
  std::vector<double> start_pose;
  double pose_tolerance = 0.05;  // rad (m), per joint
  double pose_timeout_s = 60.0;
  double settle_s = 0.3;  // at rest in the start pose before torque mode
  double connect_timeout_s = 10.0;
  std::string limits_json = "{}";
  VelocitySource velocity_source = VelocitySource::kMeasured;
  double excitation = 0.0;  // where the rollout's specification leaves it open
};

// `folder` resolves relative paths; `source` names the text in errors.
Result<AgentConfig> ParseAgentConfig(const std::string& json, const std::string& folder,
                                     const std::string& source);
Result<AgentConfig> LoadAgentConfig(const std::string& path);

// Position: the model's limits less 0.02, start ± 2π for continuous joints; velocity: 1.5 times the
// model's limit; torque: the model's effort limit. Then what limits_json says; validated with the start
// pose (`start`, n).
Result<SafetyLimits> LimitsFor(const AgentConfig& config, const model::RobotModel& model,
                               const std::vector<double>& start);

// `robot_seed`: a simulated robot's sensor noise.
Result<std::unique_ptr<Driver>> MakeDriver(const AgentConfig& config, uint64_t robot_seed);

}  // namespace rg::robot_agent
