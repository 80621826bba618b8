#include "coordinator/autoscale/autoscaler.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/ids.h"
#include "common/base/log.h"

namespace rg::coordinator::autoscale {

using nlohmann::json;
namespace fs = std::filesystem;

namespace {

constexpr char kFormat[] = "realitygrad.allocations/1";

json ToJson(const Stored& stored) {
  json list = json::array();
  for (const Allocation& a : stored.state.allocations) {
    list.push_back({{"tag", a.tag},
                    {"id", a.id},
                    {"phase", static_cast<int>(a.phase)},
                    {"asked_ns", a.asked_ns},
                    {"started_ns", a.started_ns},
                    {"joined", a.joined},
                    {"worked", a.worked},
                    {"given_back", a.given_back}});
  }
  return {{"format", kFormat},
          {"prefix", stored.prefix},
          {"next", stored.state.next},
          {"in_vain", stored.state.in_vain},
          {"not_before_ns", stored.state.not_before_ns},
          {"allocations", list}};
}

Stored FromJson(const json& file) {
  Stored stored;
  if (file.at("format") != kFormat) throw std::runtime_error("not of the format " + std::string(kFormat));
  stored.prefix = file.at("prefix");
  stored.state.next = file.at("next");
  stored.state.in_vain = file.at("in_vain");
  stored.state.not_before_ns = file.at("not_before_ns");
  for (const json& row : file.at("allocations")) {
    Allocation a;
    a.tag = row.at("tag"), a.id = row.at("id");
    a.phase = static_cast<Phase>(std::clamp(row.at("phase").get<int>(), 0, 2));
    a.asked_ns = row.at("asked_ns"), a.started_ns = row.at("started_ns");
    a.joined = row.at("joined"), a.worked = row.at("worked"), a.given_back = row.at("given_back");
    stored.state.allocations.push_back(a);
  }
  return stored;
}

std::string SiblingProgram(const char* name) {
  std::error_code error;
  return (fs::read_symlink("/proc/self/exe", error).parent_path() / name).string();
}

// Where workers on other hosts reach the coordinator.
Result<std::string> AddressForWorkers(const Flags& flags, const std::string& endpoint) {
  if (!flags.address.empty()) return flags.address;
  for (const char* any : {"tcp://0.0.0.0:", "tcp://*:", "tcp://[::]:"}) {
    if (endpoint.rfind(any, 0) == 0)
      return InvalidError("--autoscale-address: say under which address workers reach this host");
  }
  return endpoint;
}

Result<SlurmOptions> OptionsOf(const Flags& flags, const std::string& endpoint, const std::string& database) {
  RG_ASSIGN_OR_RETURN(const std::string address, AddressForWorkers(flags, endpoint));
  SlurmOptions options;
  options.slots = flags.slots;
  options.sbatch = flags.sbatch;
  std::error_code error;
  options.log_folder = fs::absolute(database, error).parent_path().string() + "/allocation-logs";
  fs::create_directories(options.log_folder, error);
  if (error) return UnavailableError(options.log_folder + ": " + error.message());
  const auto text = [](double x) {
    char buffer[32];
    std::snprintf(buffer, sizeof buffer, "%g", x);
    return std::string(buffer);
  };
  options.worker = {flags.worker.empty() ? SiblingProgram("realitygrad-worker") : flags.worker,
                    "--coordinator",
                    address,
                    "--idle-exit",
                    text(flags.idle_s),
                    "--patience",
                    text(flags.patience_s)};
  for (const std::string& tag : flags.tags) options.worker.insert(options.worker.end(), {"--tag", tag});
  if (!flags.worker_key.empty())
    options.worker.insert(options.worker.end(),
                          {"--key", flags.worker_key, "--server-key", flags.server_key});
  return options;
}

}  // namespace

void AddFlags(CLI::App& app, Flags& f) {
  const auto add = [&](const char* name, auto& value, const char* help) {
    return app.add_option(name, value, help)->group("Workers on a cluster");
  };
  add("--autoscale", f.manager, "slurm: ask Slurm for workers while there is work for them")
      ->check(CLI::IsMember({"slurm"}));
  add("--autoscale-max", f.max_allocations, "allocations at once, at the most")
      ->check(CLI::Range(1, 10'000))
      ->capture_default_str();
  add("--autoscale-slots", f.slots, "slots of each worker, and cores of its allocation")
      ->check(CLI::Range(1, 1024))
      ->capture_default_str();
  add("--autoscale-address", f.address,
      "endpoint under which the workers reach this coordinator (default: --listen)");
  add("--autoscale-worker", f.worker, "the worker program on the nodes (default: beside this program)");
  add("--autoscale-worker-key", f.worker_key, "a worker's key file on the nodes, for an encrypted endpoint");
  add("--autoscale-server-key", f.server_key, "the coordinator's public key file on the nodes");
  add("--autoscale-sbatch", f.sbatch,
      "a further argument of sbatch, as --autoscale-sbatch=--partition=gpu; several");
  add("--autoscale-tag", f.tags, "a tag of these workers: tasks that require it count for them too; several");
  add("--autoscale-idle-s", f.idle_s, "a worker leaves after so long without work")
      ->check(CLI::Range(0.5, 1e6))
      ->capture_default_str();
  add("--autoscale-patience-s", f.patience_s, "a worker leaves after so long without a coordinator")
      ->check(CLI::Range(1.0, 1e6))
      ->capture_default_str();
  add("--autoscale-period-s", f.period_s, "seconds between two looks")
      ->check(CLI::Range(0.1, 3600.0))
      ->capture_default_str();
}

Result<Stored> LoadOrMake(const std::string& path) {
  std::error_code error;
  if (!fs::exists(path, error)) {
    Stored made;
    constexpr int kBytes = 4;
    made.prefix = "realitygrad-" + RandomHex(kBytes) + "-";
    RG_RETURN_IF_ERROR(Save(path, made));
    return made;
  }
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  try {
    return FromJson(json::parse(text));
  } catch (const std::exception& wrong) {
    return InvalidError(path + ": " + wrong.what());
  }
}

Status Save(const std::string& path, const Stored& stored) {
  return WriteFileAtomically(path, ToJson(stored).dump(1) + "\n");
}

Status Autoscaler::Check(const Flags& flags, const std::string& endpoint) {
  if (flags.manager.empty()) return Status::Ok();
  if (flags.worker_key.empty() != flags.server_key.empty())
    return InvalidError("--autoscale-worker-key and --autoscale-server-key go together");
  return AddressForWorkers(flags, endpoint).status();
}

Result<std::unique_ptr<Autoscaler>> Autoscaler::Start(const Flags& flags, const std::string& endpoint,
                                                      const std::string& database, ClientOptions viewer) {
  if (flags.manager.empty()) return std::unique_ptr<Autoscaler>();
  RG_ASSIGN_OR_RETURN(const SlurmOptions options, OptionsOf(flags, endpoint, database));
  const std::string file = database + ".allocations.json";
  RG_ASSIGN_OR_RETURN(Stored stored, LoadOrMake(file));
  const Slurm slurm(options);
  const Status tried = slurm.TryOut();
  if (tried.code() == StatusCode::kInvalid)
    return InvalidError("Slurm would not take a worker: " + tried.message());
  if (!tried.ok()) spdlog::warn("Slurm does not answer yet: {}", tried.message());
  Limits limits;
  limits.max_allocations = flags.max_allocations;
  limits.slots = flags.slots;
  limits.surplus_grace_s = 3.0 * flags.period_s;
  return std::unique_ptr<Autoscaler>(
      new Autoscaler(limits, flags.tags, file, std::move(stored), slurm, std::move(viewer), flags.period_s));
}

Autoscaler::Autoscaler(Limits limits, std::vector<std::string> tags, std::string file, Stored stored,
                       Slurm slurm, ClientOptions viewer, double period_s)
    : limits_(std::move(limits)),
      tags_(std::move(tags)),
      file_(std::move(file)),
      stored_(std::move(stored)),
      slurm_(std::move(slurm)),
      viewer_(std::move(viewer)),
      period_s_(period_s),
      thread_([this] { Work(); }) {}

Autoscaler::~Autoscaler() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
  }
  wake_.notify_all();
  thread_.join();
}

void Autoscaler::Work() {
  std::unique_lock lock(mutex_);
  while (!wake_.wait_for(lock, std::chrono::duration<double>(period_s_), [this] { return stop_; })) {
    lock.unlock();
    Turn();
    lock.lock();
  }
}

void Autoscaler::Turn() {
  const auto seen = Look();
  if (!seen.ok()) return Say("the coordinator does not answer: " + seen.status().message());
  const Actions actions = Plan(stored_.prefix, limits_, *seen, stored_.state);
  for (const std::string& note : actions.notes) spdlog::info("autoscale: {}", note);
  Keep();
  for (const std::string& id : actions.give_back) GiveBack(id);
  if (actions.ask) Ask(*actions.ask);
  TidyLogs(seen->now_ns);
  const State& state = stored_.state;
  Say(state.paused ? "paused: " + std::to_string(state.in_vain) +
                         " allocations in a row were in vain; a restart goes on"
      : !seen->cluster                     ? "Slurm does not answer"
      : state.not_before_ns > seen->now_ns ? "waits after an allocation in vain"
                                           : "");
}

Result<Seen> Autoscaler::Look() {
  if (client_ == nullptr) {
    RG_ASSIGN_OR_RETURN(client_, Client::Connect(viewer_));
  }
  RG_ASSIGN_OR_RETURN(const auto status, client_->CoordinatorStatus());
  RG_ASSIGN_OR_RETURN(const auto workers, client_->Workers());
  Seen seen;
  for (const pb::ClassDemand& demand : status.demand()) {
    const bool fits = std::all_of(demand.tags().begin(), demand.tags().end(), [&](const std::string& tag) {
      return std::find(tags_.begin(), tags_.end(), tag) != tags_.end();
    });
    if (!demand.robot() && fits) seen.slots_wanted += demand.ready() + demand.running();
  }
  for (const pb::WorkerInfo& worker : workers) {
    const bool is_agents = std::any_of(worker.tags().begin(), worker.tags().end(),
                                       [](const std::string& tag) { return tag.rfind("robot:", 0) == 0; });
    if (worker.connected() && !is_agents)
      seen.workers.push_back(
          {worker.name(), worker.slots(), worker.busy() > 0, worker.draining() || !worker.unable().empty(), worker.tasks_done()});
  }
  auto listed = slurm_.List();
  if (listed.ok()) seen.cluster = *std::move(listed);
  seen.now_ns = RealClock().WallNanos();
  return seen;
}

void Autoscaler::Ask(const std::string& tag) {
  // Not written down: not asked for.
  if (written_ != ToJson(stored_).dump(1)) {
    std::erase_if(stored_.state.allocations, [&](const Allocation& a) { return a.tag == tag; });
    return;
  }
  const auto id = slurm_.Ask(tag);
  if (id.ok()) {
    spdlog::info("autoscale: allocation {} asked for as {}", *id, tag);
    NoteAsked(tag, *id, stored_.state);
  } else if (id.status().code() == StatusCode::kInvalid) {
    spdlog::error("autoscale: Slurm refused an allocation: {}", id.status().message());
    NoteRefused(tag, limits_, RealClock().WallNanos(), stored_.state);
  } else {
    spdlog::warn("autoscale: what became of {} is not known yet: {}", tag, id.status().message());
  }
  Keep();
}

void Autoscaler::GiveBack(const std::string& id) {
  const Status done = slurm_.GiveBack(id);
  if (done.ok()) return;
  spdlog::warn("autoscale: allocation {} could not be given back yet: {}", id, done.message());
  for (Allocation& a : stored_.state.allocations) {
    if (a.id == id) a.given_back = false;  // tried again
  }
}

// What an allocation printed is read, if ever, while it runs or soon after.
void Autoscaler::TidyLogs(int64_t now_ns) {
  constexpr int64_t kEveryNs = 3600'000'000'000;
  constexpr size_t kMost = 500;
  constexpr double kAge = 30.0 * 86400.0;
  if (tidied_ns_ != 0 && now_ns - tidied_ns_ < kEveryNs) return;
  tidied_ns_ = now_ns;
  std::vector<std::string> kept;
  for (const Allocation& a : stored_.state.allocations) kept.push_back(a.tag);
  const size_t removed = PruneLogs(slurm_.log_folder(), kept, kMost, kAge);
  if (removed > 0) spdlog::info("autoscale: {} old logs of allocations removed", removed);
}

void Autoscaler::Keep() {
  const std::string text = ToJson(stored_).dump(1);
  if (text == written_) return;
  const Status saved = Save(file_, stored_);
  if (saved.ok()) {
    written_ = text;
  } else {
    spdlog::error("autoscale: {}", saved.message());
  }
}

void Autoscaler::Say(std::string note) {
  const std::lock_guard lock(mutex_);
  if (note != note_ && !note.empty()) spdlog::warn("autoscale: {}", note);
  note_ = std::move(note);
  running_ = CountRunning(stored_.state);
  pending_ = CountPending(stored_.state);
  in_vain_ = stored_.state.in_vain;
}

std::string Autoscaler::StatusJson() const {
  const std::lock_guard lock(mutex_);
  return json{{"autoscale",
               {{"manager", "slurm"},
                {"running", running_},
                {"pending", pending_},
                {"in_vain", in_vain_},
                {"note", note_}}}}
      .dump();
}

}  // namespace rg::coordinator::autoscale
