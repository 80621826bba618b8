// The program realitygrad-agent: a worker with one slot beside one robot, and the kind `rollout`
// (rollout/rollout_task_kind.h).
//
// Own flags; everything else goes to worker::AgentMain:
//   --config FILE   realitygrad.agent/1 (deploy/robots/mico2_agent.json)
//   --spool FOLDER  recordings that are being made or wait for the coordinator
//   --lock-step     a simulated robot runs as fast as it can instead of in real time
//   --arm | --disarmed | --dry-run | --trusted
// or one word: status, watch, arm, disarm, stop, clear (agent_commands.h).
// Executor children, which get none of these flags, find them in the environment.
//
// The first process is the supervisor (supervisor.h), the worker its child. Recordings reach the store as
// outputs of their tasks. What stays in the spool, because there was no coordinator or a crash, is sent when
// the program starts, while it lives and when it ends, by hash, so that nothing is lost and nothing kept
// twice.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "robot_agent/agent_config.h"

namespace rg::robot_agent {

int AgentProgramMain(int argc, char** argv);

// What the flags and, in an executor child, the environment say.
struct AgentSettings {
  AgentConfig config;
  std::string config_path, spool_folder;
  std::string arm_timeout;  // seconds, as they were written; empty: it waits with the coordinator
  bool lock_step = false, dry_run = false, trusted = false;
  std::optional<bool> armed;  // said on the command line
  bool is_executor = false;
  std::vector<std::string> worker_arguments;           // for worker::AgentMain, argv[0] first
  std::string coordinator, key_path, server_key_path;  // seen on the way, for the spool
};
Result<AgentSettings> ReadAgentSettings(const std::vector<std::string>& arguments);

}  // namespace rg::robot_agent
