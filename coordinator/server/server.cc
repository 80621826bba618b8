#include "coordinator/server/server.h"

#include <unistd.h>

#include <algorithm>
#include <set>

#include "common/base/log.h"
#include "common/base/utf8.h"
#include "coordinator/store/schema.h"

namespace rg::coordinator {
namespace {

constexpr int64_t kMaxTickNs = 250'000'000;
constexpr int64_t kLogDelayNs = 250'000'000;
constexpr size_t kMaxPendingLogs = 20'000;
constexpr int64_t kTryAgainNs = 1'000'000'000, kTryAgainMaxNs = 30'000'000'000;
constexpr size_t kMaxPeers = 100'000;  // names of processes are theirs to choose
constexpr int64_t kForgetPeerNs = 3'600'000'000'000;

int64_t TickInterval(const Options& core) {
  return std::min(kMaxTickNs, std::max<int64_t>(core.heartbeat_ns / 8, 5'000'000));
}

// What a full disk is to SQLite; everything else that a commit can fail with is not survived.
bool MayPass(const Status& why) {
  return why.code() == StatusCode::kResourceExhausted || why.code() == StatusCode::kUnavailable;
}

bool IsWorkerRole(const transport::Message& message) {
  const pb::Role role = message.credentials.role;
  return role == pb::ROLE_WORKER || role == pb::ROLE_AGENT;
}

}  // namespace

Server::Server(const ServerOptions& options, std::unique_ptr<transport::Socket> socket,
               transport::Sender self, const Clock* clock)
    : options_(options), socket_(std::move(socket)), self_(std::move(self)), clock_(clock) {}

Server::~Server() {
  short_reads_.reset();  // before what they wake
  long_reads_.reset();
  transaction_.reset();
}

Result<std::unique_ptr<Server>> Server::Open(const ServerOptions& options,
                                             std::unique_ptr<transport::Socket> socket,
                                             transport::Sender self, const Clock* clock) {
  std::unique_ptr<Server> server(new Server(options, std::move(socket), std::move(self), clock));
  server->started_ns_ = clock->WallNanos();
  RG_RETURN_IF_ERROR(server->OpenStores());
  RG_RETURN_IF_ERROR(server->LoadState());
  return server;
}

Status Server::OpenStores() {
  store::DatabaseOptions options;
  options.path = options_.database_path;
  options.vfs = options_.vfs;
  constexpr int kWaitForPredecessorMs = 10'000;
  options.writer_wait_ms = kWaitForPredecessorMs;
  RG_ASSIGN_OR_RETURN(database_,
                      store::Database::Open(options, {store::ArtifactStore::Schema(),
                                                      store::ParameterStore::Schema(), CoordinatorSchema()}));
  RG_ASSIGN_OR_RETURN(const bool whole, database_->QuickCheck(options_.check_s));
  if (!whole)
    spdlog::info("{} is large: {} s were enough to check a part of it; `realitygrad db check` looks at all",
                 options_.database_path, options_.check_s);
  RG_ASSIGN_OR_RETURN(artifacts_, store::ArtifactStore::Open(database_.get(), clock_));
  parameters_ = std::make_unique<store::ParameterStore>(database_.get(), clock_);
  jobs_ = std::make_unique<JobStore>(database_.get());
  artifact_desk_ = std::make_unique<ArtifactDesk>(artifacts_.get(), parameters_.get(), clock_);
  worker_desk_ =
      std::make_unique<WorkerDesk>(database_.get(), artifacts_.get(), parameters_.get(), jobs_.get());
  freed_pages_wait_ = true;
  const bool on_disk = options_.database_path != ":memory:" && options_.vfs.empty();
  reserve_.emplace(on_disk ? options_.database_path + ".reserve" : "", options_.reserve_bytes);
  if (const Status kept = reserve_->Keep(); !kept.ok()) spdlog::warn("there is no reserve for a full disk: {}", kept.message());
  if (on_disk) {
    const auto wake = [this] {
      const uint64_t one = 1;
      if (const int fd = wake_fd_.load(); fd >= 0) {
        [[maybe_unused]] const ssize_t written = ::write(fd, &one, sizeof one);
      }
    };
    short_reads_ = std::make_unique<ReadDesk>(options_.database_path, self_, clock_, wake);
    long_reads_ = std::make_unique<ReadDesk>(options_.database_path, self_, clock_, wake);
  }
  return jobs_->ListMissingInputs();
}

Status Server::LoadState() {
  RG_ASSIGN_OR_RETURN(const StoredState stored, jobs_->Load());
  State loaded = Restore(stored, options_.core, now());
  KeepWorkers(state_, loaded, now());
  state_ = std::move(loaded);
  return Status::Ok();
}

void Server::Finish() {
  FlushLogs();
  if (transaction_ && !transaction_->Commit().ok()) spdlog::warn("the last log lines were not written");
  transaction_.reset();
}

// --- one batch ---------------------------------------------------------------------------------------

Status Server::RunOnce(int64_t timeout_ms, int wake_fd) {
  wake_fd_.store(wake_fd);
  int64_t wait_ms =
      std::clamp<int64_t>((tick_due_ns_ - clock_->SteadyNanos()) / 1'000'000 + 1, 0, timeout_ms);
  if (!deferred_.empty() || freed_pages_wait_) wait_ms = 0;
  socket_->Wait(wait_ms, wake_fd);
  if (options_.before_messages) options_.before_messages();
  NoteStall(wait_ms);
  if (trouble_.empty()) {
    for (const Event& event : std::exchange(deferred_, {})) Absorb(event, state_, now(), actions_);
  }
  ReceiveBatch();
  TickIfDue();
  if (trouble_.empty()) DispatchIfNeeded(state_, now(), actions_);
  const Status committed = CommitBatch();
  if (!committed.ok()) RG_RETURN_IF_ERROR(DiscardBatch(committed));
  TellEnds();
  SendBatch();
  RetireEnded();
  ReleaseSpace();
  return Status::Ok();
}

// When more time has passed than we meant to wait, we were stopped, or a write took very long: the silence of
// the workers is ours. They get an interval, in which each of them speaks twice; once per lease, so that a
// coordinator that is always late still finds who is lost.
void Server::NoteStall(int64_t waited_ms) {
  constexpr int64_t kLeastNs = 50'000'000;
  const Options& core = options_.core;
  const int64_t steady = clock_->SteadyNanos();
  const int64_t late = steady - last_turn_ns_ - waited_ms * 1'000'000;
  const bool is_stall = last_turn_ns_ != 0 && late > std::max(core.heartbeat_ns / 2, kLeastNs);
  last_turn_ns_ = steady;
  if (!is_stall) return;
  ++stalls_;
  if (last_grace_ns_ >= 0 && steady - last_grace_ns_ < core.lease_ns()) return;
  spdlog::warn("stalled for {:.1f} s: workers get {:.1f} s to be heard", 1e-9 * static_cast<double>(late),
               1e-9 * static_cast<double>(core.heartbeat_ns));
  last_grace_ns_ = steady;
  judge_after_ns_ = steady + core.heartbeat_ns;
}

void Server::ReceiveBatch() {
  size_t bytes = 0;
  transport::Message message;
  bool drained = false;
  for (size_t n = 0; n < options_.max_batch_messages && bytes < options_.max_batch_bytes; ++n) {
    if (!socket_->Receive(&message)) {
      drained = true;
      break;
    }
    bytes += message.envelope.payload().size() + message.attachment.size();
    Handle(std::move(message));
    message = {};
  }
  if (drained) undrained_since_ns_ = -1;
  if (!drained && undrained_since_ns_ < 0) undrained_since_ns_ = clock_->SteadyNanos();
}

void Server::Handle(transport::Message message) {
  if (message.envelope.kind() == pb::MESSAGE_KIND_EVENT) {
    HandleWorker(message);
  } else if (message.envelope.kind() == pb::MESSAGE_KIND_REQUEST) {
    HandleRequest(std::move(message));
  } else {
    ++ignored_messages_;
  }
}

void Server::TickIfDue() {
  const int64_t steady = clock_->SteadyNanos();
  if (trouble_.empty() && !logs_.empty() && steady >= logs_due_ns_) FlushLogs();
  if (steady < tick_due_ns_) return;
  tick_due_ns_ = steady + TickInterval(options_.core);
  ForgetSilentPeers(steady);
  artifact_desk_->DropIdleUploads();
  if (!trouble_.empty()) return TryToRecover();
  ArchiveIfDue(steady);
  if (!MayJudge(steady)) return;
  Absorb(Tick{}, state_, now(), actions_);
}

// A beat may be among what was not read yet; only a coordinator that never gets to the end of its queue does
// not wait for that.
bool Server::MayJudge(int64_t steady_ns) const {
  constexpr int kPatience = 4;
  return steady_ns >= judge_after_ns_ &&
         (undrained_since_ns_ < 0 || steady_ns - undrained_since_ns_ > kPatience * options_.core.lease_ns());
}

void Server::TryToRecover() {
  const int64_t steady = clock_->SteadyNanos();
  if (steady < next_try_ns_) return;
  constexpr int64_t kRoomBytes = 1 << 20;
  const AppendEvent note{clock_->WallNanos(), 0, "", "", "coordinator.recovered", trouble_};
  Status written = reserve_->Keep();
  if (written.ok()) written = jobs_->ProbeRoom(kRoomBytes);
  if (written.ok()) written = database_->InTransaction([&] { return jobs_->Apply({note}, {}); });
  if (!written.ok()) {
    next_try_ns_ = steady + try_interval_ns_;
    return;
  }
  spdlog::info("there is room again: work goes on");
  trouble_.clear();
  well_since_ns_ = steady;
  judge_after_ns_ = steady + options_.core.heartbeat_ns;
  state_.dispatch_needed = true;
  Absorb(Progressed{}, state_, now(), actions_);  // of nothing: what waits is given out
}

void Server::ForgetSilentPeers(int64_t steady_ns) {
  if (steady_ns < peers_due_ns_) return;
  peers_due_ns_ = steady_ns + kForgetPeerNs / 4;
  const Status swept = artifacts_->SweepUploads();
  if (!swept.ok()) spdlog::warn("uploads that were given up stay for now: {}", swept.ToString());
  std::erase_if(peer_by_instance_, [&](const auto& entry) {
    return steady_ns - entry.second.last_seen_ns > kForgetPeerNs &&
           state_.FindWorkerByInstance(entry.first) == nullptr;
  });
}

// A part per batch, so that nobody waits for it.
void Server::ReleaseSpace() {
  constexpr int kPagesAtOnce = 1024;
  if (!freed_pages_wait_ || (!trouble_.empty() && !frees_space_) || transaction_) return;
  const auto pages = database_->FreePages();
  freed_pages_wait_ = pages.ok() && *pages > 0;
  frees_space_ = frees_space_ && freed_pages_wait_;
  const Status released =
      freed_pages_wait_ ? database_->ReleaseFreePages(kPagesAtOnce) : database_->CheckpointPassively();
  if (released.ok()) return;
  freed_pages_wait_ = frees_space_ = false;
  spdlog::warn("freed space is not given back for now: {}", released.ToString());
}

Status Server::EnsureTransaction() {
  if (transaction_) return Status::Ok();
  RG_ASSIGN_OR_RETURN(auto transaction, database_->Begin());
  transaction_.emplace(std::move(transaction));
  return Status::Ok();
}

bool Server::NeedsCommit() const { return transaction_.has_value() || !actions_.rows.empty(); }

Status Server::CommitBatch() {
  ++batches_;
  RG_RETURN_IF_ERROR(poison_);
  if (!NeedsCommit()) return Status::Ok();
  RG_RETURN_IF_ERROR(EnsureTransaction());
  FlushLogs();
  RG_RETURN_IF_ERROR(poison_);
  RG_RETURN_IF_ERROR(jobs_->Apply(actions_.rows, results_));
  RG_RETURN_IF_ERROR(transaction_->Commit());
  transaction_.reset();
  ++commits_;
  durable_counters_ = state_.counters;
  freed_pages_wait_ = freed_pages_wait_ || space_was_freed_;
  return Status::Ok();
}

Status Server::DiscardBatch(const Status& why) {
  ++failed_commits_;
  if (transaction_) transaction_->Rollback();
  transaction_.reset();
  if (!MayPass(why)) return why.WithPrefix("a change could not be made durable");
  const int64_t steady = clock_->SteadyNanos();
  const bool is_known = !trouble_.empty();  // it was for a request that frees space
  // Room that lasts for a moment only: ask less and less often.
  const bool again_soon = try_interval_ns_ > 0 && steady - well_since_ns_ < 10 * try_interval_ns_;
  if (!is_known) {
    try_interval_ns_ = again_soon ? std::min(2 * try_interval_ns_, kTryAgainMaxNs) : kTryAgainNs;
    next_try_ns_ = steady + try_interval_ns_;
  }
  trouble_ =
      (why.code() == StatusCode::kResourceExhausted ? "disk full: " : "database busy: ") + why.message();
  if (!is_known) spdlog::error("{}; nothing new is taken until there is room", trouble_);
  const std::vector<Row> undone = std::move(actions_.rows);
  RefuseBatch(Trouble());
  poison_ = Status::Ok();
  artifact_desk_->ForgetUploads();
  const Status loaded = LoadState();
  if (!loaded.ok()) return loaded.WithPrefix(trouble_ + ", and the state cannot be read back");
  UncountBatch(undone);
  return Status::Ok();
}

void Server::UncountBatch(const std::vector<Row>& undone) {
  const uint64_t workers_lost = state_.counters.workers_lost;  // they stay so, whatever was written
  state_.counters = durable_counters_;
  state_.counters.workers_lost = workers_lost;
  for (const Row& row : undone) {
    const auto* ended = std::get_if<FinishAttempt>(&row);
    const auto lease = ended == nullptr ? state_.leases.end() : state_.leases.find(ended->token);
    if (lease == state_.leases.end()) continue;
    Worker* worker = state_.FindWorkerByInstance(lease->second.instance);
    if (worker == nullptr) continue;
    const bool failed = ended->outcome == Outcome::kFailed || ended->outcome == Outcome::kCrashed ||
                        ended->outcome == Outcome::kTimedOut;
    if (ended->outcome == Outcome::kSucceeded && worker->tasks_done > 0) --worker->tasks_done;
    if (failed && worker->tasks_failed > 0) --worker->tasks_failed;
  }
}

// Whoever asked for a part of the batch learns that it was not kept.
void Server::RefuseBatch(const Status& why) {
  std::set<const Many*> refused;
  for (const auto& [id, pending] : std::exchange(pending_, {})) {
    if (pending.many != nullptr && !refused.insert(pending.many.get()).second) continue;
    Reply(transport::MakeErrorReply(self_, pending.many != nullptr ? pending.many->request : pending.request, why));
  }
  for (const transport::Message& promise : std::exchange(promises_, {}))
    Reply(transport::MakeErrorReply(self_, promise, why));  // same peer, same request
  for (const Message& message : actions_.messages) {
    const auto* result = std::get_if<AnswerResult>(&message);
    if (result == nullptr) continue;
    pb::CoordinatorMessage answer;
    answer.mutable_result_reply()->set_token(result->token);
    answer.mutable_result_reply()->set_try_again(true);
    answer.mutable_result_reply()->set_reason(why.message());
    SendToWorker(result->instance, answer);
  }
  actions_.clear();
  results_.clear();
  space_was_freed_ = false;
}

void Server::TellEnds() {
  if (!options_.on_job_end) return;
  for (const Row& row : actions_.rows) {
    const auto* update = std::get_if<UpdateJob>(&row);
    if (update == nullptr || !IsFinal(update->record.phase)) continue;
    const Job* job = state_.FindJob(update->job);
    if (job != nullptr && job->plan->parent == 0) options_.on_job_end(Summary(update->job));
  }
}

void Server::SendBatch() {
  for (const Message& message : std::exchange(actions_.messages, {})) {
    std::visit([this](const auto& m) { Translate(m); }, message);
  }
  actions_.clear();
  results_.clear();
  space_was_freed_ = false;
  for (transport::Message& promise : std::exchange(promises_, {})) Reply(std::move(promise));
  for (const transport::Message& query : queries_) Reply(AnswerQuery(query));
  queries_.clear();
  TakeReaderAnswers();
  AnswerWatchers();
  overviews_.clear();
  for (transport::Message& message : std::exchange(outbox_, {})) SendReply(std::move(message));
}

// A reply that the other end would drop as too large is replaced by an error that says so.
void Server::SendReply(transport::Message message) {
  const size_t bytes = message.envelope.payload().size() + message.attachment.size();
  if (message.envelope.kind() == pb::MESSAGE_KIND_REPLY && bytes > options_.max_reply_bytes) {
    message = transport::MakeErrorReply(
        self_, message,
        ResourceExhaustedError("the reply of " + std::to_string(bytes >> 20) + " MiB is above the limit of " +
                               std::to_string(options_.max_reply_bytes >> 20) +
                               " MiB: ask for less at once"));
  }
  const Status sent = socket_->Send(message);
  if (!sent.ok()) spdlog::debug("not sent to {}: {}", message.envelope.type(), sent.ToString());
}

void Server::SetAllowedKeys(const transport::AllowList& allowed) {
  const auto is_allowed = [&](const std::string& name, pb::Role role) {
    for (const auto& row : allowed.Rows()) {
      if (row.entry.name == name && row.entry.role == role) return true;
    }
    return false;
  };
  std::vector<std::string> over;
  for (const auto& [instance, peer] : peer_by_instance_) {
    if (!peer.key_name.empty() && !is_allowed(peer.key_name, peer.role)) over.push_back(instance);
  }
  for (const std::string& instance : over) {
    spdlog::info("the session of {} is over: its key was revoked", instance);
    peer_by_instance_.erase(instance);
    deferred_.push_back(WorkerLeft{instance});
  }
  std::erase_if(watchers_, [&](const Watcher& watcher) {
    const transport::Credentials& who = watcher.request.credentials;
    return who.authenticated && !is_allowed(who.name, who.role);
  });
}

// --- workers -------------------------------------------------------------------------------------------

std::optional<pb::WorkerMessage> Server::AdmitWorker(const transport::Message& message) {
  auto body = transport::Unpack<pb::WorkerMessage>(message);
  const std::string& instance = message.envelope.sender_id();
  if (!body.ok() || !IsWorkerRole(message) || instance.empty()) return std::nullopt;
  if (peer_by_instance_.size() >= kMaxPeers && peer_by_instance_.count(instance) == 0) return std::nullopt;
  const auto [peer, is_new] = peer_by_instance_.try_emplace(
      instance, Peer{message.peer, message.credentials.name, message.credentials.role, 0});
  // Another key's worker may not speak for it.
  if (!is_new && peer->second.key_name != message.credentials.name) return std::nullopt;
  peer->second.routing_id = message.peer;
  peer->second.last_seen_ns = clock_->SteadyNanos();
  return *std::move(body);
}

void Server::HandleWorker(const transport::Message& message) {
  const std::string& instance = message.envelope.sender_id();
  const auto body = AdmitWorker(message);
  if (!body) {
    ++ignored_messages_;
    return;
  }
  if (!body->database().empty() && body->database() != database_->identity()) return TellDatabase(instance);
  if (!trouble_.empty() && !body->has_log()) return PutOff(*body, instance);
  switch (body->message_case()) {
    case pb::WorkerMessage::kHello:
      return HandleHello(*body, message);
    case pb::WorkerMessage::kFinished:
      return HandleFinished(body->finished(), instance);
    case pb::WorkerMessage::kLog:
      return HandleLog(body->log(), instance);
    case pb::WorkerMessage::kCheckpoint:
      return HandleCheckpoint(body->checkpoint(), instance);
    default:
      break;
  }
  const auto event = WorkerDesk::ToEvent(*body, instance);
  if (!event) {
    ++ignored_messages_;
    return;
  }
  Absorb(*event, state_, now(), actions_);
  if (body->has_bye()) peer_by_instance_.erase(instance);
}

void Server::HandleHello(const pb::WorkerMessage& body, const transport::Message& message) {
  const std::string& instance = message.envelope.sender_id();
  const Status allowed = CheckHello(options_.policy, message.credentials, body.hello());
  if (!allowed.ok()) return RefuseJoining(instance, allowed.message());
  auto event = WorkerDesk::ToEvent(body, instance);
  if (!event) {
    ++ignored_messages_;
    return;
  }
  std::get<WorkerJoined>(*event).key = message.credentials.name;
  Absorb(*event, state_, now(), actions_);
}

void Server::RefuseJoining(const std::string& instance, const std::string& why) {
  pb::CoordinatorMessage out;
  out.set_refused(why);
  SendToWorker(instance, out);
}

// Numbers of jobs and tokens begin again with every database: what it says is of other tasks.
void Server::TellDatabase(const std::string& instance) {
  pb::CoordinatorMessage out;
  out.set_another_database(database_->identity());
  SendToWorker(instance, out);
}

// While nothing can be written, workers keep what they have: leases are not judged, results are sent again.
// What else they say they will repeat, or it is of the moment only.
void Server::PutOff(const pb::WorkerMessage& body, const std::string& instance) {
  pb::CoordinatorMessage answer;
  if (body.has_heartbeat()) {
    answer.mutable_heartbeat_reply()->set_known(state_.FindWorkerByInstance(instance) != nullptr);
    answer.mutable_heartbeat_reply()->set_trouble(trouble_);
  } else if (body.has_finished() || body.has_failed()) {
    answer.mutable_result_reply()->set_token(body.has_finished() ? body.finished().token()
                                                                 : body.failed().token());
    answer.mutable_result_reply()->set_try_again(true);
    answer.mutable_result_reply()->set_reason(trouble_);
  } else {
    return;
  }
  SendToWorker(instance, answer);
}

void Server::HandleFinished(const pb::TaskFinished& finished, const std::string& instance) {
  const Lease* lease = state_.FindLease(finished.token(), instance);
  Finished event = WorkerDesk::ToFinished(finished, instance);
  if (lease == nullptr) {
    if (state_.FindJob(JobOf(finished.task())) == nullptr) {  // a repeat, perhaps, of what is over
      const auto committed = jobs_->CommittedToken(finished.task());
      if (committed.ok()) event.committed = *committed;
    }
    return Absorb(event, state_, now(), actions_);
  }
  const auto missing = worker_desk_->MissingOutputs(finished);
  if (!missing.empty()) {
    pb::CoordinatorMessage answer;
    answer.mutable_result_reply()->set_token(finished.token());
    for (const std::string& sha256 : missing) answer.mutable_result_reply()->add_missing_sha256(sha256);
    return SendToWorker(instance, answer);
  }
  const Status begun = EnsureTransaction();
  if (!begun.ok()) return poison_ = begun, void();
  auto stored = worker_desk_->StoreOutputs(state_, *lease, finished);
  if (stored.ok()) {
    event.task = lease->task;
    event.seconds = stored->seconds;
    results_[finished.token()] = *std::move(stored);
    return Absorb(event, state_, now(), actions_);
  }
  const StatusCode code = stored.status().code();
  if (code == StatusCode::kResourceExhausted || code == StatusCode::kUnavailable ||
      code == StatusCode::kInternal) {
    poison_ = stored.status();  // our own trouble, not the task's
    actions_.messages.emplace_back(AnswerResult{instance, finished.token(), false, ""});
    return;
  }
  Absorb(Failed{instance, lease->task, finished.token(), Outcome::kFailed, stored.status().ToString(), false},
         state_, now(), actions_);
}

void Server::HandleLog(const pb::TaskLogReport& report, const std::string& instance) {
  const Lease* lease = state_.FindLease(report.token(), instance);
  if (lease == nullptr) return;
  if (logs_.empty()) logs_due_ns_ = clock_->SteadyNanos() + kLogDelayNs;
  for (const pb::TaskLogLine& line : report.lines()) {
    if (logs_.size() >= kMaxPendingLogs) {
      ++log_lines_dropped_;
      continue;
    }
    const int64_t wall_ns = line.wall_ns() != 0 ? line.wall_ns() : clock_->WallNanos();
    logs_.push_back(
        {lease->task, lease->attempt, wall_ns, 0, CleanUtf8(line.text(), options_.max_log_line_bytes)});
  }
}

// Log lines wait for the next transaction, or a moment: they alone are not worth an fsync each.
void Server::FlushLogs() {
  if (logs_.empty() || !EnsureTransaction().ok()) return;
  for (const LogRow& row : std::exchange(logs_, {})) {
    const Status written = jobs_->AppendLog(row);
    if (!written.ok()) return poison_ = written, void();
  }
}

void Server::HandleCheckpoint(const pb::TaskCheckpointReport& report, const std::string& instance) {
  const Lease* lease = state_.FindLease(report.token(), instance);
  if (lease == nullptr) return;
  Status saved = EnsureTransaction();
  if (saved.ok())
    saved = jobs_->SaveCheckpoint(lease->task, report.token(), report.sequence(), report.bytes());
  if (!saved.ok()) poison_ = saved;
}

void Server::SendToWorker(const std::string& instance, const pb::CoordinatorMessage& message) {
  const auto peer = peer_by_instance_.find(instance);
  if (peer == peer_by_instance_.end()) return;
  transport::Message out = transport::MakeEvent(self_, message);
  out.peer = peer->second.routing_id;
  outbox_.push_back(std::move(out));
}

void Server::Translate(const Welcome& m) {
  pb::CoordinatorMessage out;
  auto* welcome = out.mutable_welcome();
  welcome->set_heartbeat_ms(static_cast<uint32_t>(options_.core.heartbeat_ns / 1'000'000));
  welcome->set_lease_ms(static_cast<uint32_t>(options_.core.lease_ns() / 1'000'000));
  welcome->set_inline_limit(options_.inline_limit);
  welcome->set_chunk_bytes(1 << 20);
  welcome->set_max_artifact_bytes(static_cast<uint64_t>(artifacts_->options().max_artifact_bytes));
  welcome->set_coordinator(self_.id);
  welcome->set_database(database_->identity());
  SendToWorker(m.instance, out);
}

void Server::Translate(const Assign& m) {
  auto assignment = worker_desk_->Assemble(state_, m);
  if (!assignment.ok()) {
    deferred_.push_back(
        Failed{m.instance, m.task, m.token, Outcome::kFailed, assignment.status().ToString(), false});
    return;
  }
  pb::CoordinatorMessage out;
  *out.mutable_assign() = *std::move(assignment);
  SendToWorker(m.instance, out);
}

void Server::Translate(const GrantStart& m) {
  pb::CoordinatorMessage out;
  out.mutable_start_granted()->set_token(m.token);
  SendToWorker(m.instance, out);
}

void Server::Translate(const Revoke& m) {
  pb::CoordinatorMessage out;
  out.mutable_revoke()->set_token(m.token);
  out.mutable_revoke()->set_reason(m.reason);
  SendToWorker(m.instance, out);
}

void Server::Translate(const AnswerResult& m) {
  pb::CoordinatorMessage out;
  out.mutable_result_reply()->set_token(m.token);
  out.mutable_result_reply()->set_accepted(m.accepted);
  out.mutable_result_reply()->set_reason(m.reason);
  SendToWorker(m.instance, out);
}

void Server::Translate(const AnswerBeat& m) {
  pb::CoordinatorMessage out;
  out.mutable_heartbeat_reply()->set_known(m.known);
  SendToWorker(m.instance, out);
}

void Server::Translate(const TellDrain& m) {
  pb::CoordinatorMessage out;
  out.mutable_drain();
  SendToWorker(m.instance, out);
}

}  // namespace rg::coordinator
