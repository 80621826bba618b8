#include "coordinator/server/server.h"

#include <algorithm>

#include "common/base/log.h"
#include "common/base/utf8.h"
#include "coordinator/store/schema.h"

namespace rg::coordinator {
namespace {

constexpr int64_t kMaxTickNs = 250'000'000;
constexpr int64_t kLogDelayNs = 250'000'000;
constexpr size_t kMaxPendingLogs = 20'000;

int64_t TickInterval(const Options& core) {
  return std::min(kMaxTickNs, std::max<int64_t>(core.heartbeat_ns / 8, 5'000'000));
}

bool IsWorkerRole(const transport::Message& message) {
  const pb::Role role = message.credentials.role;
  return role == pb::ROLE_WORKER || role == pb::ROLE_AGENT;
}

}  // namespace

Server::Server(const ServerOptions& options, std::unique_ptr<transport::Socket> socket,
               transport::Sender self, const Clock* clock)
    : options_(options), socket_(std::move(socket)), self_(std::move(self)), clock_(clock) {}

Server::~Server() { transaction_.reset(); }

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
  constexpr int kWaitForPredecessorMs = 10'000;
  options.writer_wait_ms = kWaitForPredecessorMs;
  RG_ASSIGN_OR_RETURN(database_,
                      store::Database::Open(options, {store::ArtifactStore::Schema(),
                                                      store::ParameterStore::Schema(), CoordinatorSchema()}));
  RG_ASSIGN_OR_RETURN(artifacts_, store::ArtifactStore::Open(database_.get(), clock_));
  parameters_ = std::make_unique<store::ParameterStore>(database_.get(), clock_);
  jobs_ = std::make_unique<JobStore>(database_.get());
  artifact_desk_ = std::make_unique<ArtifactDesk>(artifacts_.get(), parameters_.get(), clock_);
  worker_desk_ =
      std::make_unique<WorkerDesk>(database_.get(), artifacts_.get(), parameters_.get(), jobs_.get());
  return Status::Ok();
}

Status Server::LoadState() {
  RG_ASSIGN_OR_RETURN(const StoredState stored, jobs_->Load());
  const Counters counters = state_.counters;
  const uint64_t revision = state_.revision;
  state_ = Restore(stored, options_.core, now());
  state_.counters = counters;
  state_.revision += revision;
  return Status::Ok();
}

void Server::Finish() {
  FlushLogs();
  if (transaction_ && !transaction_->Commit().ok()) spdlog::warn("the last log lines were not written");
  transaction_.reset();
}

// --- one batch ---------------------------------------------------------------------------------------

void Server::RunOnce(int64_t timeout_ms, int wake_fd) {
  int64_t wait_ms =
      std::clamp<int64_t>((tick_due_ns_ - clock_->SteadyNanos()) / 1'000'000 + 1, 0, timeout_ms);
  if (!deferred_.empty()) wait_ms = 0;
  socket_->Wait(wait_ms, wake_fd);
  for (const Event& event : std::exchange(deferred_, {})) React(event, state_, now(), actions_);
  ReceiveBatch();
  TickIfDue();
  const Status committed = CommitBatch();
  if (!committed.ok()) return DiscardBatch(committed);
  SendBatch();
}

void Server::ReceiveBatch() {
  size_t bytes = 0;
  transport::Message message;
  for (size_t n = 0; n < options_.max_batch_messages && bytes < options_.max_batch_bytes; ++n) {
    if (!socket_->Receive(&message)) break;
    bytes += message.envelope.payload().size() + message.attachment.size();
    Handle(std::move(message));
    message = {};
  }
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
  if (!logs_.empty() && steady >= logs_due_ns_) FlushLogs();
  if (steady < tick_due_ns_) return;
  tick_due_ns_ = steady + TickInterval(options_.core);
  React(Tick{}, state_, now(), actions_);
  artifact_desk_->DropIdleUploads();
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
  if (poisoned_) return InternalError(poison_);
  if (!NeedsCommit()) return Status::Ok();
  RG_RETURN_IF_ERROR(EnsureTransaction());
  FlushLogs();
  RG_RETURN_IF_ERROR(jobs_->Apply(actions_.rows, results_));
  RG_RETURN_IF_ERROR(transaction_->Commit());
  transaction_.reset();
  ++commits_;
  return Status::Ok();
}

void Server::DiscardBatch(const Status& why) {
  ++failed_commits_;
  spdlog::error("a batch could not be made durable and is dropped: {}", why.ToString());
  if (transaction_) transaction_->Rollback();
  transaction_.reset();
  actions_.clear();
  results_.clear();
  queries_.clear();
  outbox_.clear();
  pending_.clear();
  poisoned_ = false;
  artifact_desk_->ForgetUploads();
  const Status loaded = LoadState();
  if (!loaded.ok()) spdlog::error("the state could not be loaded again: {}", loaded.ToString());
}

void Server::SendBatch() {
  for (const Message& message : std::exchange(actions_.messages, {})) {
    std::visit([this](const auto& m) { Translate(m); }, message);
  }
  actions_.clear();
  results_.clear();
  for (const transport::Message& query : queries_) Reply(AnswerQuery(query));
  queries_.clear();
  AnswerWatchers();
  for (const transport::Message& message : outbox_) {
    const Status sent = socket_->Send(message);
    if (!sent.ok()) spdlog::debug("not sent to {}: {}", message.envelope.type(), sent.ToString());
  }
  outbox_.clear();
}

// --- workers -------------------------------------------------------------------------------------------

void Server::HandleWorker(const transport::Message& message) {
  auto body = transport::Unpack<pb::WorkerMessage>(message);
  const std::string& instance = message.envelope.sender_id();
  if (!body.ok() || !IsWorkerRole(message) || instance.empty()) {
    ++ignored_messages_;
    return;
  }
  const auto [peer, is_new] =
      peer_by_instance_.try_emplace(instance, Peer{message.peer, message.credentials.name});
  if (!is_new &&
      peer->second.key_name != message.credentials.name) {  // another key's worker may not speak for it
    ++ignored_messages_;
    return;
  }
  peer->second.routing_id = message.peer;
  switch (body->message_case()) {
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
  React(*event, state_, now(), actions_);
  if (body->has_bye()) peer_by_instance_.erase(instance);
}

void Server::HandleFinished(const pb::TaskFinished& finished, const std::string& instance) {
  const Lease* lease = state_.FindLease(finished.token(), instance);
  if (lease == nullptr)
    return React(Finished{instance, finished.task(), finished.token()}, state_, now(), actions_);
  const auto missing = worker_desk_->MissingOutputs(finished);
  if (!missing.empty()) {
    pb::CoordinatorMessage answer;
    answer.mutable_result_reply()->set_token(finished.token());
    for (const std::string& sha256 : missing) answer.mutable_result_reply()->add_missing_sha256(sha256);
    return SendToWorker(instance, answer);
  }
  const Status begun = EnsureTransaction();
  if (!begun.ok()) return poisoned_ = true, poison_ = begun.ToString(), void();
  auto stored = worker_desk_->StoreOutputs(state_, *lease, finished);
  if (stored.ok()) {
    results_[finished.token()] = *std::move(stored);
    return React(Finished{instance, lease->task, finished.token()}, state_, now(), actions_);
  }
  const StatusCode code = stored.status().code();
  if (code == StatusCode::kResourceExhausted || code == StatusCode::kUnavailable ||
      code == StatusCode::kInternal) {
    poisoned_ = true;  // our own trouble, not the task's
    poison_ = stored.status().ToString();
    return;
  }
  React(Failed{instance, lease->task, finished.token(), Outcome::kFailed, stored.status().ToString(), false},
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
    if (!written.ok()) return poisoned_ = true, poison_ = written.ToString(), void();
  }
}

void Server::HandleCheckpoint(const pb::TaskCheckpointReport& report, const std::string& instance) {
  const Lease* lease = state_.FindLease(report.token(), instance);
  if (lease == nullptr) return;
  Status saved = EnsureTransaction();
  if (saved.ok())
    saved = jobs_->SaveCheckpoint(lease->task, report.token(), report.sequence(), report.bytes());
  if (!saved.ok()) poisoned_ = true, poison_ = saved.ToString();
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
