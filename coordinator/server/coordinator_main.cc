#include "coordinator/server/coordinator_main.h"

#include <signal.h>
#include <sys/eventfd.h>
#include <sys/stat.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <cstdio>
#include <tuple>
#include <utility>

#include "common/base/file.h"
#include "common/base/finite_flags.h"
#include "common/base/ids.h"
#include "common/base/log.h"
#include "common/transport/zmq_socket.h"
#include "coordinator/autoscale/autoscaler.h"
#include "coordinator/server/end_hook.h"
#include "coordinator/server/scheduled_backups.h"
#include "coordinator/server/server.h"
#include "coordinator/web/web_server.h"
#include "google/protobuf/stubs/logging.h"

namespace rg::coordinator {
namespace {

constexpr int kExitError = 1;
constexpr int kExitUsage = 2;

std::atomic<bool> stop{false};
int wake_fd = -1;

void OnSignal(int number) {
  if (number != SIGHUP) stop.store(true);  // a changed list of keys is seen by itself
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
  double uncertain_s = 30.0, archive_days = 30.0;
  int64_t archive_above = 2'000'000;
  int64_t max_message_mb = 128;
  std::string backup_every, on_end;
  int backups_kept = 14;
  std::vector<std::string> robot_kinds, may_submit;
  web::WebFlags web;
  autoscale::Flags autoscale;
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
  app.add_option(
         "--archive-days", f.archive_days,
         "jobs that ended so long ago are archived: still shown, but without logs and events (0: never)")
      ->check(CLI::Range(0.0, 1e5))
      ->capture_default_str();
  app.add_option("--archive-above", f.archive_above,
                 "the oldest jobs are archived while more tasks of ended jobs than this are not (0: never)")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  app.add_option("--backup-every", f.backup_every,
                 "a checked copy of the database so often (90m, 24h, 7d), in the folder `backups` beside it")
      ->envname("REALITYGRAD_BACKUP_EVERY");
  app.add_option("--keep", f.backups_kept, "of these backups, so many; the oldest go")
      ->check(CLI::Range(1, 100'000))
      ->capture_default_str();
  app.add_option("--on-end", f.on_end, "shell command that is run when a job ends, with the job as JSON on its stdin");
  app.add_option("--max-message-mb", f.max_message_mb, "larger messages are dropped")
      ->check(CLI::Range(1, 1024))
      ->capture_default_str();
  app.add_option("--key", f.key_path, "key file: encrypts; needed on every address but loopback and ipc")
      ->envname("REALITYGRAD_KEY");
  app.add_option("--allowed-keys", f.allowed_path,
                 "who may connect, one '<role> <public key> <name>' per line")
      ->envname("REALITYGRAD_ALLOWED_KEYS");
  app.add_option("--robot-kind", f.robot_kinds,
                 "kind of tasks that move a robot, besides 'rollout': at most once, by agents only, for "
                 "operators with the right to robots")
      ->group("Kinds of your own");
  app.add_option("--may-submit", f.may_submit,
                 "'KIND:OTHER': a task of KIND may submit tasks of kind OTHER, besides diagnose:fit")
      ->group("Kinds of your own");
  app.add_option("--log-level", f.log_level, "debug, info, warn, error");
  web::AddWebFlags(app, f.web);
  autoscale::AddFlags(app, f.autoscale);
}

// The system chooses a port for tcp://…:*; people write 0.
std::string Endpoint(const std::string& listen) {
  const size_t colon = listen.rfind(':');
  return colon != std::string::npos && listen.substr(colon) == ":0" ? listen.substr(0, colon) + ":*" : listen;
}

// The list of allowed keys as it is now, looked at before anything that came is: who was revoked before is out. A
// file that is just being written in its place, or is gone while somebody edits it, revokes nobody.
class KeyWatch {
 public:
  KeyWatch(const std::string& path, transport::Context& context)
      : path_(path), file_(path), context_(context) {}

  // The page in this process comes in as a viewer, with a key of this run.
  const transport::KeyPair& page_key() const { return page_key_; }

  // `server` is null before there is one.
  Status Look(Server* server) {
    if (server != nullptr && !IsToBeRead()) return Status::Ok();
    RG_ASSIGN_OR_RETURN(auto allowed, file_.Changed());
    if (!allowed) return Status::Ok();
    spdlog::info("{} keys may connect", allowed->size());
    RG_RETURN_IF_ERROR(allowed->Add(page_key_.public_key, pb::ROLE_VIEWER, "web-page"));
    context_.SetAllowList(*allowed);
    if (server != nullptr) server->SetAllowedKeys(*allowed);
    return Status::Ok();
  }

 private:
  // Another file in its place is whole (`keys allow|revoke`); one that was written over is, when it stays for a
  // moment as it is. What the clock says does not matter: it may have been set back.
  bool IsToBeRead() {
    constexpr int64_t kAtRestNs = 200'000'000;
    struct stat seen = {};
    if (path_.empty() || stat(path_.c_str(), &seen) != 0) return false;
    const bool is_another = std::exchange(file_number_, seen.st_ino) != seen.st_ino;
    const Written written{seen.st_mtim.tv_sec, seen.st_mtim.tv_nsec, seen.st_size};
    const bool is_changed = std::exchange(written_, written) != written;
    const int64_t now = RealClock().SteadyNanos();
    if (is_changed) changed_ns_ = now;
    if (!is_another && (changed_ns_ == 0 || now - changed_ns_ < kAtRestNs)) return false;
    changed_ns_ = 0;
    return true;
  }

  const std::string path_;
  transport::AllowListFile file_;
  transport::Context& context_;
  const transport::KeyPair page_key_ = transport::GenerateKeyPair();
  using Written = std::tuple<int64_t, int64_t, int64_t>;  // when, and how much
  Written written_;
  ino_t file_number_ = 0;
  int64_t changed_ns_ = 0;  // since when it is as it is, and was not read yet; 0: it was
};

Result<Policy> PolicyOf(const Flags& flags) {
  Policy policy;
  policy.robot_kinds.insert(flags.robot_kinds.begin(), flags.robot_kinds.end());
  for (const std::string& pair : flags.may_submit) {
    const size_t colon = pair.find(':');
    if (colon == 0 || colon == std::string::npos || colon + 1 == pair.size())
      return InvalidError("--may-submit '" + pair + "': must be KIND:OTHER");
    policy.may_submit[pair.substr(0, colon)].insert(pair.substr(colon + 1));
  }
  return policy;
}

Result<transport::RouterOptions> PrepareRouter(const Flags& flags, const transport::Sender& self,
                                               KeyWatch& keys) {
  transport::RouterOptions options;
  options.self = self;
  options.allow_plain_loopback = flags.key_path.empty();
  options.limits.max_message_bytes = static_cast<size_t>(flags.max_message_mb) << 20;
  constexpr int kHighWater = 10'000;
  options.high_water_messages = kHighWater;
  if (flags.key_path.empty() != flags.allowed_path.empty()) {
    return InvalidError("--key and --allowed-keys go together");
  }
  if (flags.key_path.empty()) return options;
  RG_ASSIGN_OR_RETURN(const auto key, transport::LoadKeyFile(flags.key_path));
  options.server_key = key.keys;
  RG_RETURN_IF_ERROR(keys.Look(nullptr));
  return options;
}

Status Announce(const Flags& flags, const std::string& endpoint) {
  std::printf("listening on %s\n", endpoint.c_str());
  std::fflush(stdout);
  return flags.address_file.empty() ? Status::Ok() : WriteFileAtomically(flags.address_file, endpoint + "\n");
}

// What stands beside the coordinator, in threads of its own, and is a viewer to it.
class Beside {
 public:
  Beside(const Flags& flags, const std::string& endpoint, const transport::RouterOptions& router,
         const KeyWatch& keys)
      : flags_(flags), endpoint_(endpoint) {
    const bool encrypted = router.server_key.has_value();
    viewer_ = web::ViewerOf(endpoint, encrypted ? std::optional(keys.page_key()) : std::nullopt,
                            encrypted ? router.server_key->public_key : "");
  }

  // Refuses what cannot be, before there is a database.
  Status Prepare() {
    RG_RETURN_IF_ERROR(autoscale::Autoscaler::Check(flags_.autoscale, endpoint_));
    std::function<std::string()> more_status;
    if (!flags_.autoscale.manager.empty()) more_status = [this] { return autoscaler_->StatusJson(); };
    RG_ASSIGN_OR_RETURN(page_, web::WebServer::Bind(flags_.web, viewer_, more_status));
    return Status::Ok();
  }
  Status Start() {
    RG_ASSIGN_OR_RETURN(autoscaler_,
                        autoscale::Autoscaler::Start(flags_.autoscale, endpoint_, flags_.database, viewer_));
    return page_ ? page_->Start() : Status::Ok();
  }
  void Stop() {
    page_.reset();
    autoscaler_.reset();
  }

 private:
  const Flags& flags_;
  const std::string endpoint_;
  ClientOptions viewer_;
  std::unique_ptr<autoscale::Autoscaler> autoscaler_;
  std::unique_ptr<web::WebServer> page_;  // shows the one above
};

std::string RemedyFor(const Status& status, const std::string& database) {
  if (status.code() != StatusCode::kDataLoss) return "";
  return " (`realitygrad db check --db " + database + "` says what is damaged, `realitygrad restore BACKUP --db " +
         database + " --overwrite` puts a backup in its place)";
}

Status Serve(const Flags& flags) {
  ServerOptions options;
  RG_ASSIGN_OR_RETURN(options.policy, PolicyOf(flags));
  transport::Context context;
  const transport::Sender self{"coordinator-" + RandomHex(6), pb::ROLE_COORDINATOR};
  KeyWatch keys(flags.allowed_path, context);
  RG_ASSIGN_OR_RETURN(const auto router_options, PrepareRouter(flags, self, keys));
  RG_ASSIGN_OR_RETURN(auto router, transport::BindRouter(context, Endpoint(flags.listen), router_options));
  const std::string endpoint = router->endpoint();
  Beside beside(flags, endpoint, router_options, keys);
  RG_RETURN_IF_ERROR(beside.Prepare());
  options.database_path = flags.database;
  options.core.heartbeat_ns = flags.heartbeat_ms * 1'000'000;
  constexpr double kNsPerDay = 86'400e9;
  options.archive_after_ns = static_cast<int64_t>(flags.archive_days * kNsPerDay);
  options.archive_above_tasks = flags.archive_above;
  options.core.uncertain_ns = static_cast<int64_t>(flags.uncertain_s * 1e9);
  BackupOptions backups{flags.database, 0.0, flags.backups_kept};
  const auto interval = ParseInterval(flags.backup_every);
  if (!interval.ok()) return interval.status().WithPrefix("--backup-every");
  backups.every_s = *interval;
  EndHook end_hook(flags.on_end);
  options.on_job_end = [&](const pb::JobSummary& job) { end_hook.JobEnded(job); };
  std::unique_ptr<Server> server;
  options.before_messages = [&] {
    const Status allowed = keys.Look(server.get());
    if (!allowed.ok()) spdlog::error("the list of allowed keys stays as it was: {}", allowed.ToString());
  };
  RG_ASSIGN_OR_RETURN(server, Server::Open(options, std::move(router), self, &RealClock()));
  RG_RETURN_IF_ERROR(beside.Start());
  const ScheduledBackups keeper(backups);
  RG_RETURN_IF_ERROR(Announce(flags, endpoint));
  spdlog::info("{} jobs under way in {}", server->state().jobs.size(), flags.database);
  while (!stop.load()) {
    uint64_t count;
    [[maybe_unused]] const ssize_t drained = read(wake_fd, &count, sizeof(count));
    RG_RETURN_IF_ERROR(server->RunOnce(1'000, wake_fd));
  }
  beside.Stop();
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
    CheckFlagsFinite(app);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : kExitUsage;
  }
  InitLogging("realitygrad-coordinator", flags.log_level);
  google::protobuf::SetLogHandler(
      nullptr);  // bytes of peers that do not parse are counted; they must not fill the log
  CatchSignals();
  const Status status = Serve(flags);
  if (status.ok()) return 0;
  spdlog::error("{}{}", status.message(), RemedyFor(status, flags.database));
  return status.code() == StatusCode::kInvalid ? kExitUsage : kExitError;
}

}  // namespace rg::coordinator
