#include "robot_agent/agent_program.h"

#include <cstdlib>
#include <iostream>
#include <memory>
#include <nlohmann/json.hpp>

#include "common/base/hash.h"
#include "common/base/log.h"
#include "common/transport/keys.h"
#include "coordinator/client/client.h"
#include "robot_agent/agent_commands.h"
#include "robot_agent/rollout/rollout_task.h"
#include "robot_agent/rollout/rollout_task_kind.h"
#include "robot_agent/spool.h"
#include "robot_agent/spool_delivery.h"
#include "robot_agent/supervisor.h"
#include "services/rollouts/recording_bundle.h"
#include "worker/task_registry.h"
#include "worker/worker_main.h"

namespace rg::robot_agent {
namespace {

constexpr char kConfigVariable[] = "REALITYGRAD_AGENT_CONFIG";
constexpr char kSpoolVariable[] = "REALITYGRAD_AGENT_SPOOL";
constexpr char kLockStepVariable[] = "REALITYGRAD_AGENT_LOCK_STEP";
constexpr char kTrustedVariable[] = "REALITYGRAD_AGENT_TRUSTED";
constexpr char kArmTimeoutVariable[] = "REALITYGRAD_AGENT_ARM_TIMEOUT";
constexpr char kDryRunVariable[] = "REALITYGRAD_AGENT_DRY_RUN";
constexpr char kDefaultCoordinator[] = "tcp://127.0.0.1:7341";

constexpr char kHelp[] =
    "realitygrad-agent: flags of its own\n"
    "  --config FILE               what stands beside the robot, realitygrad.agent/1 (required)\n"
    "  --spool FOLDER              recordings being made or waiting for the coordinator (default: "
    "~/.local/state/realitygrad/spool)\n"
    "  --lock-step                 a simulated robot runs as fast as it can, not in real time\n"
    "  --arm, --disarmed           rollouts may begin at once, or only after `realitygrad agent arm` "
    "(default: a\n"
    "                              simulated arm is armed, any other is not)\n"
    "  --arm-timeout SECONDS       a rollout waits so long for the arm to be armed, then it fails (default: it waits "
    "with the\n"
    "                              coordinator until the arm is armed)\n"
    "  --trusted                   rollouts are not short and slow at first: the arm is a stand-in\n"
    "  --dry-run                   states are read and torques computed and shown; nothing is sent to the "
    "arm\n"
    "While it runs: realitygrad agent status|watch|arm|disarm|stop|clear (--help says more)\n\n";

std::string Environment(const char* name, const std::string& otherwise = "") {
  const char* value = std::getenv(name);
  return value != nullptr ? value : otherwise;
}

// Takes "--name value" or "--name=value" at arguments[i]; i ends on the last word used.
bool TakeValue(const std::vector<std::string>& arguments, const std::string& name, size_t* i,
               std::string* value) {
  const std::string& word = arguments[*i];
  if (word.rfind(name + "=", 0) == 0) {
    *value = word.substr(name.size() + 1);
    return true;
  }
  if (word != name || *i + 1 >= arguments.size()) return false;
  *value = arguments[++*i];
  return true;
}

void ReadFlags(const std::vector<std::string>& arguments, AgentSettings* settings) {
  for (size_t i = 0; i < arguments.size(); ++i) {
    const size_t first = i;
    if (TakeValue(arguments, "--config", &i, &settings->config_path)) continue;
    if (TakeValue(arguments, "--spool", &i, &settings->spool_folder)) continue;
    if (TakeValue(arguments, "--arm-timeout", &i, &settings->arm_timeout)) continue;
    if (arguments[i] == "--lock-step") {
      settings->lock_step = true;
      continue;
    }
    if (arguments[i] == "--arm" || arguments[i] == "--disarmed") {
      settings->armed = arguments[i] == "--arm";
      continue;
    }
    if (arguments[i] == "--trusted") {
      settings->trusted = true;
      continue;
    }
    if (arguments[i] == "--dry-run") {
      settings->dry_run = true;
      continue;
    }
    // Passed on, but of interest here too.
    std::string ignored;
    if (TakeValue(arguments, "--executor-fd", &i, &ignored)) settings->is_executor = true;
    if (i == first) TakeValue(arguments, "--coordinator", &i, &settings->coordinator);
    if (i == first) TakeValue(arguments, "-c", &i, &settings->coordinator);
    if (i == first) TakeValue(arguments, "--key", &i, &settings->key_path);
    if (i == first) TakeValue(arguments, "--server-key", &i, &settings->server_key_path);
    for (size_t k = first; k <= i; ++k) settings->worker_arguments.push_back(arguments[k]);
  }
}

void TellExecutors(const AgentSettings& settings) {
  setenv(kConfigVariable, settings.config_path.c_str(), 1);
  setenv(kSpoolVariable, settings.spool_folder.c_str(), 1);
  setenv(kLockStepVariable, settings.lock_step ? "1" : "0", 1);
  setenv(kTrustedVariable, settings.trusted ? "1" : "0", 1);
  setenv(kDryRunVariable, settings.dry_run ? "1" : "0", 1);
  setenv(kArmTimeoutVariable, settings.arm_timeout.c_str(), 1);
}

Result<std::unique_ptr<coordinator::Client>> ConnectFor(const AgentSettings& settings) {
  coordinator::ClientOptions options;
  options.address = settings.coordinator;
  options.name = "agent-" + settings.config.name;
  options.connect_timeout_ms = 1'000;
  options.attempts = 1;
  if (!settings.key_path.empty()) {
    RG_ASSIGN_OR_RETURN(const auto own, transport::LoadKeyFile(settings.key_path));
    RG_ASSIGN_OR_RETURN(const auto server, transport::LoadPublicKeyFile(settings.server_key_path));
    options.key = own.keys;
    options.role = own.role;
    options.server_public_key = server.keys.public_key;
  }
  return coordinator::Client::Connect(options);
}

// Job, task and what it was made from, as if it had come as the task's output.
realitygrad::v1::ArtifactInfo InfoOf(coordinator::Client& client, const std::string& metadata_json,
                                     const std::string& database) {
  realitygrad::v1::ArtifactInfo info;
  info.set_kind(rollouts::kBundleKind);
  info.set_metadata_json(metadata_json);
  const auto metadata = nlohmann::json::parse(metadata_json, nullptr, false);
  if (!metadata.is_object()) return info;
  const auto text = [&](const char* name) {
    return metadata.contains(name) && metadata[name].is_string() ? metadata[name].get<std::string>()
                                                                 : std::string();
  };
  if (text("database") == database) {  // another one has other jobs under these numbers
    info.set_job_id(text("job"));
    info.set_task_id(text("task"));
  }
  for (const char* parent : {"model_sha256", "policy_sha256"}) {
    const std::string sha256 = text(parent);
    if (!sha256.empty() && client.ShowArtifact(sha256).ok()) info.add_parents(sha256);
  }
  return info;
}

Status DeliverTo(coordinator::Client& client, const std::string& bundle, const std::string& metadata_json) {
  const std::string sha256 = Sha256Hex(bundle);
  const auto known = client.ShowArtifact(sha256);
  if (known.ok()) return Status::Ok();
  if (known.status().code() != StatusCode::kNotFound) return known.status();
  RG_ASSIGN_OR_RETURN(const auto coordinator, client.CoordinatorStatus());
  return client.PutArtifact(bundle, InfoOf(client, metadata_json, coordinator.database_identity())).status();
}

// Best effort: what cannot be sent stays where it is, and so does what is younger than `least_age_s`.
void EmptySpool(const AgentSettings& settings, double least_age_s) {
  std::unique_ptr<coordinator::Client> client;
  const auto deliver = [&](const std::string& id, const std::string& bundle, const std::string& metadata) {
    if (client == nullptr) {
      RG_ASSIGN_OR_RETURN(client, ConnectFor(settings));
    }
    const Status sent = DeliverTo(*client, bundle, metadata);
    if (sent.ok()) spdlog::info("the store has recording {}; it left the spool", id);
    return sent;
  };
  const auto delivered = DeliverSpool(settings.spool_folder, deliver, least_age_s);
  if (!delivered.ok()) spdlog::warn("spool {}: {}", settings.spool_folder, delivered.status().ToString());
}

int RunWorker(const AgentSettings& settings) {
  worker::TaskRegistry registry;
  RegisterRolloutKind(settings.config, settings.spool_folder, &registry);
  std::vector<std::string> words = settings.worker_arguments;
  if (!settings.is_executor) words.insert(words.end(), {"--robot", settings.config.name});
  std::vector<char*> argv;
  for (auto& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  std::function<std::string()> waits_for;
  if (settings.config.arm_timeout_s == 0.0)
    waits_for = [&settings] { return WaitsFor(settings.config, settings.spool_folder); };
  return worker::AgentMain(static_cast<int>(words.size()), argv.data(), registry, std::move(waits_for));
}

// Seconds; none: 0.
Result<double> ParseArmTimeout(const std::string& text) {
  if (text.empty()) return 0.0;
  char* end = nullptr;
  const double seconds = std::strtod(text.c_str(), &end);
  constexpr double kMost = 1e6;
  if (*end == 0 && seconds > 0.0 && seconds <= kMost) return seconds;
  return InvalidError("realitygrad-agent: --arm-timeout '" + text + "' is no number of seconds above 0 and up to 1e6");
}

}  // namespace

Result<AgentSettings> ReadAgentSettings(const std::vector<std::string>& arguments) {
  AgentSettings settings;
  settings.config_path = Environment(kConfigVariable);
  settings.spool_folder = Environment(kSpoolVariable, DefaultSpoolFolder());
  settings.lock_step = Environment(kLockStepVariable) == "1";
  settings.dry_run = Environment(kDryRunVariable) == "1";
  settings.trusted = Environment(kTrustedVariable) == "1";
  settings.arm_timeout = Environment(kArmTimeoutVariable);
  settings.coordinator = Environment("REALITYGRAD_COORDINATOR", kDefaultCoordinator);
  settings.key_path = Environment("REALITYGRAD_KEY");
  settings.server_key_path = Environment("REALITYGRAD_SERVER_KEY");
  ReadFlags(arguments, &settings);
  if (settings.config_path.empty()) return InvalidError("realitygrad-agent: needs --config FILE");
  RG_ASSIGN_OR_RETURN(settings.config, LoadAgentConfig(settings.config_path));
  settings.config.simulated.lock_step |= settings.lock_step;
  settings.config.dry_run = settings.dry_run;
  RG_ASSIGN_OR_RETURN(settings.config.arm_timeout_s, ParseArmTimeout(settings.arm_timeout));
  if (settings.trusted) settings.config.first_rollouts = {};
  return settings;
}

int AgentProgramMain(int argc, char** argv) {
  const std::vector<std::string> arguments(argv, argv + argc);
  if (const auto code = RunAgentCommand(arguments)) return *code;
  for (const auto& word : arguments) {
    if (word != "--help" && word != "-h") continue;
    std::cout << kHelp;
    return worker::AgentMain(argc, argv, worker::TaskRegistry());
  }
  const auto settings = ReadAgentSettings(arguments);
  if (!settings.ok()) {
    std::cerr << settings.status().message() << "\n";
    return 2;
  }
  if (settings->is_executor) return RunWorker(*settings);
  TellExecutors(*settings);
  InitLogging("realitygrad-agent");
  const bool simulated = settings->config.arm_ends_with_driver();
  SupervisorOptions options;
  options.spool_folder = settings->spool_folder;
  options.robot = settings->config.name;
  options.driver = settings->config.driver;
  options.armed = settings->armed.value_or(simulated);
  options.arm_ends_with_driver = simulated;
  options.dry_run = settings->dry_run;
  return Supervise(
      options, [&] { return RunWorker(*settings); },
      [&](double least_age_s) { EmptySpool(*settings, least_age_s); });
}

}  // namespace rg::robot_agent
