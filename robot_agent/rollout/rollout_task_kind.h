// Task kind `rollout`, for the agent beside a robot.
#pragma once

#include <string>

#include "robot_agent/agent_config.h"

namespace rg::worker {
class TaskRegistry;
}

namespace rg::robot_agent {

// Runs rollouts of `config.name` only; recordings wait in `spool_folder` until they are committed.
void RegisterRolloutKind(const AgentConfig& config, const std::string& spool_folder,
                         worker::TaskRegistry* registry);

}  // namespace rg::robot_agent
