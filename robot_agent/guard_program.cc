#include "robot_agent/guard_program.h"

#include <signal.h>

#include <CLI/CLI.hpp>

#include "common/base/log.h"
#include "robot_agent/agent_config.h"
#include "robot_agent/drivers/kinova/arm_session.h"
#include "robot_agent/guard/guard.h"
#include "robot_agent/realtime.h"
#include "robot_agent/safety/own_arm.h"

namespace rg::robot_agent {
namespace {

struct GuardFlags {
  std::string config, spool;
  uint64_t seed = 1;
  int socket_fd = -1;
  bool lock_step = false;
};

// The driver's threads too, which begin later; not a simulated arm, which is a process that computes, and nobody
// where the robot's time waits.
void GetOnTime(const AgentConfig& config) {
  if (config.simulated.lock_step) return;
  const RealtimeGrant grant = AskForRealtime(kGuardPriority, !config.arm_ends_with_driver());
  if (grant.why.empty()) {
    spdlog::info("memory locked, FIFO priority {}", grant.fifo_priority);
  } else {
    spdlog::warn("less punctual than it could be: {} (docs/safety.md)", grant.why);
  }
}

Status RunGuard(const GuardFlags& flags) {
  RG_ASSIGN_OR_RETURN(AgentConfig config, LoadAgentConfig(flags.config));
  config.simulated.lock_step |= flags.lock_step;
  if (!flags.spool.empty()) config.kinova.session_path = flags.spool + "/" + kinova::kSessionFile;
  RG_ASSIGN_OR_RETURN(const auto driver, MakeDriver(config, flags.seed));
  OwnArm arm(*config.arm, Eigen::Map<const Eigen::Vector3d>(config.gravity.data()), config.parts);
  const PacketSocket socket(flags.socket_fd);
  GetOnTime(config);
  GuardOptions options;
  options.latch_folder = flags.spool;
  Guard(*driver, arm, config.limits, socket, options).Run();
  return Status::Ok();
}

}  // namespace

int GuardProgramMain(int argc, char** argv) {
  GuardFlags flags;
  CLI::App app("Stands between realitygrad-agent, which starts it, and its arm.", "realitygrad-guard");
  app.add_option("--config", flags.config, "realitygrad.agent/1")->required();
  app.add_option("--spool", flags.spool, "the agent's folder, for its latch");
  app.add_option("--seed", flags.seed, "of a simulated robot's sensor noise");
  app.add_option("--socket-fd", flags.socket_fd, "serve the agent on this open socket")->required();
  app.add_flag("--lock-step", flags.lock_step, "a simulated robot waits for the agent");
  CLI11_PARSE(app, argc, argv);
  for (const int number : {SIGINT, SIGTERM, SIGHUP, SIGPIPE}) signal(number, SIG_IGN);
  InitLogging("realitygrad-guard");
  const Status status = RunGuard(flags);
  if (status.ok()) return 0;
  spdlog::error("{}", status.ToString());
  return 1;
}

}  // namespace rg::robot_agent
