// realitygrad-agent: the worker beside one robot. Its own flags are --config, --spool and --lock-step;
// the rest are a worker's.
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include "robot_agent/agent_config.h"
#include "services/jobs/rollout_task_kind.h"
#include "worker/worker_main.h"

namespace {

// Executors are children of this program that are started without its flags: they find them here.
constexpr char kConfigVariable[] = "REALITYGRAD_AGENT_CONFIG";
constexpr char kSpoolVariable[] = "REALITYGRAD_AGENT_SPOOL";
constexpr char kLockStepVariable[] = "REALITYGRAD_AGENT_LOCK_STEP";

constexpr char kUsage[] =
    "realitygrad-agent --config FILE [--spool FOLDER] [--lock-step] [worker flags]\n"
    "  --config FILE    realitygrad.agent/1: robot, driver, limits, start pose\n"
    "  --spool FOLDER   recordings wait here until the coordinator has them (default: realitygrad-spool)\n"
    "  --lock-step      a simulated robot does not wait for real time\n"
    "and the flags of a worker:\n";

// Takes `name VALUE` out of the arguments and into the environment.
bool TakeValue(std::vector<char*>& arguments, const char* name, const char* variable) {
  for (size_t i = 1; i < arguments.size(); ++i) {
    if (std::strcmp(arguments[i], name) != 0) continue;
    if (i + 1 >= arguments.size()) return false;
    setenv(variable, arguments[i + 1], 1);
    arguments.erase(arguments.begin() + static_cast<long>(i), arguments.begin() + static_cast<long>(i) + 2);
    return true;
  }
  return true;
}

bool TakeFlag(std::vector<char*>& arguments, const char* name) {
  for (size_t i = 1; i < arguments.size(); ++i) {
    if (std::strcmp(arguments[i], name) != 0) continue;
    arguments.erase(arguments.begin() + static_cast<long>(i));
    return true;
  }
  return false;
}

std::string Variable(const char* name, const char* otherwise) {
  const char* value = std::getenv(name);
  return value && *value ? value : otherwise;
}

}  // namespace

int main(int argc, char** argv) {
  std::vector<char*> arguments(argv, argv + argc);
  if (!TakeValue(arguments, "--config", kConfigVariable) ||
      !TakeValue(arguments, "--spool", kSpoolVariable)) {
    std::fprintf(stderr, "realitygrad-agent: --config and --spool need a value\n");
    return 2;
  }
  if (TakeFlag(arguments, "--lock-step")) setenv(kLockStepVariable, "1", 1);
  for (char* argument : arguments) {
    if (std::strcmp(argument, "--help") == 0 || std::strcmp(argument, "-h") == 0) {
      std::fputs(kUsage, stdout);
      std::fflush(stdout);
      return rg::worker::AgentMain(static_cast<int>(arguments.size()), arguments.data(), {});
    }
  }
  const std::string path = Variable(kConfigVariable, "");
  if (path.empty()) {
    std::fprintf(stderr,
                 "realitygrad-agent: --config is missing (for example deploy/robots/mico2_agent.json)\n");
    return 2;
  }
  auto config = rg::robot_agent::LoadAgentConfig(path);
  if (!config.ok()) {
    std::fprintf(stderr, "realitygrad-agent: %s\n", config.status().message().c_str());
    return 1;
  }
  if (!Variable(kLockStepVariable, "").empty()) config->simulated.lock_step = true;
  rg::worker::TaskRegistry registry;
  rg::jobs::RegisterAgentKinds(*config, Variable(kSpoolVariable, "realitygrad-spool"), &registry);
  std::string robot_flag = "--robot=" + config->name;
  arguments.push_back(robot_flag.data());
  return rg::worker::AgentMain(static_cast<int>(arguments.size()), arguments.data(), registry);
}
