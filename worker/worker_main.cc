#include "worker/worker_main.h"

#include <signal.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cstring>

#include "common/base/finite_flags.h"
#include "common/base/log.h"
#include "worker/executor_child.h"
#include "worker/worker.h"

namespace rg::worker {
namespace {

constexpr int kExitError = 1;
constexpr int kExitUsage = 2;
constexpr int kExitUnreachable = 6;
constexpr char kExecutorFlag[] = "--executor-fd";

int signal_fd = -1;

void OnSignal(int) {
  const uint64_t one = 1;
  [[maybe_unused]] const ssize_t written = write(signal_fd, &one, sizeof(one));
}

void CatchSignals() {
  signal_fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
  struct sigaction action = {};
  action.sa_handler = OnSignal;
  sigaction(SIGTERM, &action, nullptr);
  sigaction(SIGINT, &action, nullptr);
  signal(SIGPIPE, SIG_IGN);
}

struct Flags {
  WorkerOptions options;
  std::string key_path, server_key_path, robot, log_level;
  double cache_gb = 8.0;
};

void AddFlags(CLI::App& app, Flags& flags, bool is_agent) {
  WorkerOptions& o = flags.options;
  app.add_option("-c,--coordinator", o.coordinator,
                 "endpoint of the coordinator, tcp://host:port or ipc://path")
      ->envname("REALITYGRAD_COORDINATOR")
      ->default_val("tcp://127.0.0.1:7341");
  app.add_option("--name", o.name, "unique among the workers (default: host and process)");
  if (is_agent) {
    // The agent takes it from its configuration: nobody else says it.
    app.add_option("--robot", flags.robot, "name of the robot beside this program; its tag is robot:NAME")
        ->required()
        ->group("");
  } else {
    app.add_option("-j,--slots", o.slots, "tasks at once (default: one per core)");
  }
  app.add_option("--tag", o.tags, "a tag that tasks may require; may be given more than once");
  app.add_option("--folder", o.folder, "cache of artefacts and scratch space")
      ->envname("REALITYGRAD_WORKER_FOLDER");
  app.add_option("--cache-gb", flags.cache_gb, "limit of the cache")->capture_default_str();
  app.add_option("--drain-timeout", o.drain_timeout_s,
                 "seconds for what runs after SIGTERM (0: as long as it takes)");
  app.add_option("--cancel-grace", o.cancel_grace_s, "seconds for a cancelled task to return (a rollout has as many as its stop may take)")
      ->capture_default_str();
  app.add_option("--patience", o.patience_s, "seconds without a coordinator before it gives up (0: never)");
  app.add_option("--idle-exit", o.idle_exit_s, "seconds without work before it leaves (0: never)");
  app.add_option("--key", flags.key_path, "own key file: encrypts the connection")
      ->envname("REALITYGRAD_KEY");
  app.add_option("--server-key", flags.server_key_path, "the coordinator's public key file")
      ->envname("REALITYGRAD_SERVER_KEY");
  app.add_option("--log-level", flags.log_level, "debug, info, warn, error");
}

Status LoadKeys(Flags& flags, realitygrad::v1::Role role) {
  if (flags.key_path.empty() != flags.server_key_path.empty()) {
    return InvalidError("--key and --server-key go together");
  }
  if (flags.key_path.empty()) return Status::Ok();
  RG_ASSIGN_OR_RETURN(const auto own, transport::LoadKeyFile(flags.key_path));
  if (own.role != role) {
    return InvalidError(flags.key_path + ": this key is for the role " +
                        std::string(transport::RoleName(own.role)) + ", not " +
                        std::string(transport::RoleName(role)));
  }
  RG_ASSIGN_OR_RETURN(const auto server, transport::LoadPublicKeyFile(flags.server_key_path));
  flags.options.key = own.keys;
  flags.options.server_public_key = server.keys.public_key;
  return Status::Ok();
}

int ExitCodeOf(const Status& status) {
  if (status.ok()) return 0;
  spdlog::error("{}", status.message());
  if (status.code() == StatusCode::kInvalid) return kExitUsage;
  return status.code() == StatusCode::kUnavailable ? kExitUnreachable : kExitError;
}

int Main(int argc, char** argv, const TaskRegistry& registry, bool is_agent, std::function<std::string()> waits_for) {
  if (const auto code = ServeIfExecutor(argc, argv, registry)) return *code;
  CLI::App app{is_agent ? "Runs rollouts beside a robot for a RealityGrad coordinator"
                        : "Runs tasks for a RealityGrad coordinator"};
  Flags flags;
  AddFlags(app, flags, is_agent);
  try {
    app.parse(argc, argv);
    CheckFlagsFinite(app);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : kExitUsage;
  }
  InitLogging(is_agent ? "realitygrad-agent" : "realitygrad-worker", flags.log_level);
  const Status keys = LoadKeys(flags, is_agent ? realitygrad::v1::ROLE_AGENT : realitygrad::v1::ROLE_WORKER);
  if (!keys.ok()) return ExitCodeOf(keys);
  WorkerOptions& options = flags.options;
  options.kinds = registry.kinds();
  options.least_grace_s = registry.least_grace_s();
  options.is_agent = is_agent;
  options.waits_for = std::move(waits_for);
  options.cache_bytes = static_cast<uint64_t>(flags.cache_gb * 1e9);
  options.executor_arguments = {argv[0]};
  if (is_agent) {
    options.slots = 1;
    options.tags.push_back("robot:" + flags.robot);
  }
  CatchSignals();
  auto worker = Worker::Open(options, &RealClock());
  if (!worker.ok()) return ExitCodeOf(worker.status());
  return ExitCodeOf((*worker)->Run(signal_fd));
}

}  // namespace

std::optional<int> ServeIfExecutor(int argc, char** argv, const TaskRegistry& registry) {
  for (int i = 1; i + 1 < argc; ++i) {
    if (std::strcmp(argv[i], kExecutorFlag) != 0) continue;
    InitLogging("executor");
    return ServeAsExecutor(std::atoi(argv[i + 1]), registry);
  }
  return std::nullopt;
}

int WorkerMain(int argc, char** argv, const TaskRegistry& registry) {
  return Main(argc, argv, registry, false, {});
}

int AgentMain(int argc, char** argv, const TaskRegistry& registry, std::function<std::string()> waits_for) {
  return Main(argc, argv, registry, true, std::move(waits_for));
}

}  // namespace rg::worker
