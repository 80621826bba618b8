#include "coordinator/server/coordinator_main.h"

#include <signal.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <cstdio>

#include "common/base/file.h"
#include "common/base/ids.h"
#include "common/base/log.h"
#include "common/transport/zmq_socket.h"
#include "coordinator/server/server.h"

namespace rg::coordinator {
namespace {

constexpr int kExitError = 1;
constexpr int kExitUsage = 2;

std::atomic<bool> stop{false};
std::atomic<bool> reload{false};
int wake_fd = -1;

void OnSignal(int number) {
  (number == SIGHUP ? reload : stop).store(true);
  const uint64_t one = 1;
  [[maybe_unused]] const ssize_t written = write(wake_fd, &one, sizeof(one));
}

void CatchSignals() {
  wake_fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
  struct sigaction action = {};
  action.sa_handler = OnSignal;
  for (const int number : {SIGTERM, SIGINT, SIGHUP}) sigaction(number, &action, nullptr);
  signal(SIGPIPE, SIG_IGN);
}

struct Flags {
  std::string listen = "tcp://127.0.0.1:7341";
  std::string database = "realitygrad.db";
  std::string address_file, key_path, allowed_path, log_level;
  int64_t heartbeat_ms = 2000;
  double uncertain_s = 30.0;
  int64_t max_message_mb = 128;
};

void AddFlags(CLI::App& app, Flags& f) {
  app.add_option("--listen", f.listen,
                 "endpoint to listen on, tcp://address:port (port 0: any free one) or ipc://path")
      ->envname("REALITYGRAD_LISTEN")
      ->capture_default_str();
  app.add_option("--db", f.database, "the database; made if it is not there")
      ->envname("REALITYGRAD_DB")
      ->capture_default_str();
  app.add_option("--address-file", f.address_file, "where to write the endpoint as it was bound");
  app.add_option("--heartbeat-ms", f.heartbeat_ms,
                 "interval of workers' heartbeats; a lease lasts two of them")
      ->check(CLI::Range(50, 600'000))
      ->capture_default_str();
  app.add_option("--uncertain-s", f.uncertain_s, "how long an at-most-once task waits for its lost worker")
      ->check(CLI::Range(0.0, 1e6))
      ->capture_default_str();
  app.add_option("--max-message-mb", f.max_message_mb, "larger messages are dropped")
      ->check(CLI::Range(1, 1024))
      ->capture_default_str();
  app.add_option("--key", f.key_path, "key file: encrypts; needed on every address but loopback and ipc")
      ->envname("REALITYGRAD_KEY");
  app.add_option("--allowed-keys", f.allowed_path,
                 "who may connect, one '<role> <public key> <name>' per line")
      ->envname("REALITYGRAD_ALLOWED_KEYS");
  app.add_option("--log-level", f.log_level, "debug, info, warn, error");
}

// The system chooses a port for tcp://…:*; people write 0.
std::string Endpoint(const std::string& listen) {
  const size_t colon = listen.rfind(':');
  return colon != std::string::npos && listen.substr(colon) == ":0" ? listen.substr(0, colon) + ":*" : listen;
}

Status AllowKeys(transport::Context& context, const std::string& path) {
  RG_ASSIGN_OR_RETURN(auto allowed, transport::LoadAllowList(path));
  spdlog::info("{} keys may connect", allowed.size());
  context.SetAllowList(std::move(allowed));
  return Status::Ok();
}

Result<transport::RouterOptions> PrepareRouter(const Flags& flags, const transport::Sender& self,
                                               transport::Context& context) {
  transport::RouterOptions options;
  options.self = self;
  options.allow_plain_loopback = flags.key_path.empty();
  options.limits.max_message_bytes = static_cast<size_t>(flags.max_message_mb) << 20;
  constexpr int kHighWater = 100'000;
  options.high_water_messages = kHighWater;
  if (flags.key_path.empty() != flags.allowed_path.empty()) {
    return InvalidError("--key and --allowed-keys go together");
  }
  if (flags.key_path.empty()) return options;
  RG_ASSIGN_OR_RETURN(const auto key, transport::LoadKeyFile(flags.key_path));
  options.server_key = key.keys;
  RG_RETURN_IF_ERROR(AllowKeys(context, flags.allowed_path));
  return options;
}

Status Announce(const Flags& flags, const std::string& endpoint) {
  std::printf("listening on %s\n", endpoint.c_str());
  std::fflush(stdout);
  return flags.address_file.empty() ? Status::Ok() : WriteFileAtomically(flags.address_file, endpoint + "\n");
}

Status Serve(const Flags& flags) {
  transport::Context context;
  const transport::Sender self{"coordinator-" + RandomHex(6), pb::ROLE_COORDINATOR};
  RG_ASSIGN_OR_RETURN(const auto router_options, PrepareRouter(flags, self, context));
  RG_ASSIGN_OR_RETURN(auto router, transport::BindRouter(context, Endpoint(flags.listen), router_options));
  const std::string endpoint = router->endpoint();
  ServerOptions options;
  options.database_path = flags.database;
  options.core.heartbeat_ns = flags.heartbeat_ms * 1'000'000;
  options.core.uncertain_ns = static_cast<int64_t>(flags.uncertain_s * 1e9);
  RG_ASSIGN_OR_RETURN(auto server, Server::Open(options, std::move(router), self, &RealClock()));
  RG_RETURN_IF_ERROR(Announce(flags, endpoint));
  spdlog::info("{} jobs in {}", server->state().jobs.size(), flags.database);
  while (!stop.load()) {
    if (reload.exchange(false) && !flags.allowed_path.empty()) {
      const Status allowed = AllowKeys(context, flags.allowed_path);
      if (!allowed.ok()) spdlog::error("the list of allowed keys stays as it was: {}", allowed.ToString());
    }
    uint64_t count;
    [[maybe_unused]] const ssize_t drained = read(wake_fd, &count, sizeof(count));
    server->RunOnce(1'000, wake_fd);
  }
  server->Finish();
  return Status::Ok();
}

}  // namespace

int CoordinatorMain(int argc, char** argv) {
  CLI::App app{"Schedules RealityGrad's jobs and keeps their results"};
  Flags flags;
  AddFlags(app, flags);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : kExitUsage;
  }
  InitLogging("realitygrad-coordinator", flags.log_level);
  CatchSignals();
  const Status status = Serve(flags);
  if (status.ok()) return 0;
  spdlog::error("{}", status.message());
  return status.code() == StatusCode::kInvalid ? kExitUsage : kExitError;
}

}  // namespace rg::coordinator
