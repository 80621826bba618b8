// Task kind `rollout`, for the agent beside a robot.
#pragma once

#include <string>

#include "robot_agent/agent_config.h"

namespace rg::worker {
class TaskRegistry;
}

namespace rg::jobs {

// Runs rollouts of `config.name` only; recordings wait in `spool_folder` until they are committed.
void RegisterAgentKinds(const robot_agent::AgentConfig& config, const std::string& spool_folder,
                        worker::TaskRegistry* registry);

}  // namespace rg::jobs
