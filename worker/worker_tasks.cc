// The part of the worker that brings a task from its assignment to its report.
#include <unistd.h>

#include <algorithm>

#include "common/base/log.h"
#include "worker/worker.h"

namespace rg::worker {
namespace {

namespace pb = realitygrad::v1;

constexpr int64_t kNsPerSecond = 1'000'000'000;

}  // namespace

// --- inputs ------------------------------------------------------------------------------------------------

void Worker::TakeTransferResults() {
  uint64_t count = 0;
  [[maybe_unused]] const ssize_t drained = read(transfer_fd_, &count, sizeof(count));
  for (TransferResult& result : transfers_->TakeResults()) {
    const uint64_t token = result.transfer.token;
    const bool is_fetch = result.transfer.kind == Transfer::Kind::kFetch;
    Status status = result.status;
    if (is_fetch && status.ok()) cache_.Took(result.transfer.sha256, result.bytes);
    const auto found = held_.find(token);
    if (found == held_.end() || result.transfer.database != database_) continue;
    Held& held = found->second;
    const bool expected = held.stage == (is_fetch ? Stage::kFetching : Stage::kUploading);
    if (!expected) continue;
    if (status.code() == StatusCode::kUnavailable) {  // the coordinator is away: the lease decides
      transfers_->Add(std::move(result.transfer));
      continue;
    }
    --held.open_transfers;
    const bool of_node = status.code() == StatusCode::kResourceExhausted || status.code() == StatusCode::kInternal;
    if (is_fetch && of_node) {
      RestFromTrouble(held, "input " + result.transfer.sha256 + ": " + status.message());
    } else if (!status.ok()) {
      const std::string what = is_fetch ? "input " : "output ";
      ReportFailure(
          held, pb::ATTEMPT_OUTCOME_FAILED, what + result.transfer.sha256 + ": " + status.ToString(),
          status.code() != StatusCode::kInvalid && status.code() != StatusCode::kFailedPrecondition);
    } else if (held.open_transfers == 0) {
      is_fetch ? InputsAreHere(token, held) : ReportFinished(held);
    }
  }
}

void Worker::InputsAreHere(uint64_t, Held& held) {
  for (int i = 0; i < held.assignment.inputs_size(); ++i) {
    cache_.Find(held.assignment.inputs(i).sha256(), &held.input_paths[static_cast<size_t>(i)]);
  }
  held.stage = held.assignment.at_most_once() ? Stage::kAwaitingGrant : Stage::kQueued;
  if (held.stage == Stage::kAwaitingGrant) {
    held.next_send_ns = 1;  // at once
  }
}

// --- running -----------------------------------------------------------------------------------------------

void Worker::StartQueued() {
  if (!refused_.empty() || !node_trouble_.empty() || now() < rest_until_ns_) return;
  if (!unable_.empty()) {  // rested: the next task tells
    unable_.clear();
    next_beat_ns_ = 0;
  }
  for (auto& [token, held] : held_) {
    if (held.stage != Stage::kQueued) continue;
    const auto running = std::count_if(executors_.begin(), executors_.end(),
                                       [](const auto& executor) { return executor->token() != 0; });
    if (running >= static_cast<long>(options_.slots)) return GiveBackWhatWaits();
    Start(token, held);
    if (!unable_.empty()) return;
  }
}

// Tasks that were given ahead because they are short, behind one that is not: others may have a slot free.
void Worker::GiveBackWhatWaits() {
  constexpr int64_t kLongNs = 1'000'000'000;
  for (auto& [token, held] : held_) {
    if (held.stage != Stage::kQueued) continue;
    if (held.queued_ns == 0) held.queued_ns = now();
    if (now() - held.queued_ns < kLongNs) continue;
    ReportFailure(held, pb::ATTEMPT_OUTCOME_LOST, "given back: it waited behind another task", true);
  }
}

void Worker::Start(uint64_t, Held& held) {
  Executor* executor = IdleExecutor();
  if (executor == nullptr) return;  // it rests
  pb::RunTask run;
  *run.mutable_assignment() = held.assignment;
  for (const std::string& path : held.input_paths) run.add_input_paths(path);
  run.set_scratch_folder(held.scratch);
  run.set_inline_limit(inline_limit_);
  pb::Access* access = run.mutable_access();
  access->set_coordinator(options_.coordinator);
  access->set_role(self_.role);
  if (options_.key) {
    access->set_public_key(options_.key->public_key);
    access->set_secret_key(options_.key->secret_key);
    access->set_server_public_key(options_.server_public_key);
  }
  held.executor = executor;
  held.stage = Stage::kRunning;
  if (held.assignment.timeout_s() > 0.0) {
    held.deadline_ns = now() + static_cast<int64_t>(held.assignment.timeout_s() * kNsPerSecond);
  }
  const Status sent = executor->Run(run);
  if (sent.code() == StatusCode::kResourceExhausted) {  // too large a payload
    executor->SetIdle();
    held.executor = nullptr;
    held.deadline_ns = 0;
    return ReportFailure(held, pb::ATTEMPT_OUTCOME_FAILED, sent.ToString(), false);
  }
  if (!sent.ok())
    spdlog::debug("executor {}: {}", executor->pid(), sent.ToString());  // ReadExecutors sees its end
}

Executor* Worker::IdleExecutor() {
  for (const auto& executor : executors_) {
    if (executor->token() == 0) return executor.get();
  }
  auto started = Executor::Start(options_.executor_arguments);
  if (!started.ok()) {
    RestFromStarting(started.status().message());
    return nullptr;
  }
  executors_.push_back(*std::move(started));
  return executors_.back().get();
}

// The fault is this machine's (no process, no memory, a library that is gone), not the tasks': they go back as they came,
// and nothing is tried here for a while; with fewer executors it goes on with those. What was granted to run once, and
// has not, waits here.
void Worker::RestFromStarting(const std::string& why) {
  const auto up = std::count_if(executors_.begin(), executors_.end(), [](const auto& e) { return e->is_ready(); });
  if (up > 0) {
    options_.slots = static_cast<uint32_t>(up);
    spdlog::error("{}; goes on with {} slots", why, up);
    return SendHello();
  }
  Rest(why, starts_in_vain_++);
}

// The same of a task that this machine had no room for: it is for others, and this one looks again later.
void Worker::RestFromTrouble(Held& held, const std::string& why) {
  Rest(why, troubles_++);
  GiveBackForNode(held, why);
}

void Worker::Rest(const std::string& why, int times_before) {
  constexpr int kLongestShift = 6;
  const double rest_s = options_.executor_rest_s * (1 << std::min(times_before, kLongestShift));
  rest_until_ns_ = now() + static_cast<int64_t>(rest_s * kNsPerSecond);
  unable_ = why;
  spdlog::error("{}; nothing is tried for {} s", why, rest_s);
  next_beat_ns_ = 0;
  SendBeatIfDue();  // or it would all come back at once
  GiveBackWhatHasNotBegun(why);
}

void Worker::GiveBackWhatHasNotBegun(const std::string& why) {
  for (auto& [token, held] : held_) {
    const bool waits = held.stage == Stage::kFetching || held.stage == Stage::kAwaitingGrant || held.stage == Stage::kQueued;
    const bool granted = held.assignment.at_most_once() && held.stage == Stage::kQueued;
    if (waits && !granted && !held.revoked) ReportFailure(held, pb::ATTEMPT_OUTCOME_LOST, "given back: " + why, true);
  }
}

void Worker::ReadExecutors() {
  for (size_t i = 0; i < executors_.size();) {
    Executor& executor = *executors_[i];
    std::vector<pb::FromExecutor> messages;
    std::vector<std::string> lines;
    const bool alive = executor.Read(&messages, &lines);
    for (const std::string& line : lines) AddLog(executor.token(), line, clock_->WallNanos());
    if (executor.token() != 0 && executor.is_ready()) starts_in_vain_ = 0;
    for (pb::FromExecutor& message : messages) HandleExecutorMessage(message);
    if (alive) {
      ++i;
      continue;
    }
    HandleExecutorEnd(executor);
    executors_.erase(executors_.begin() + static_cast<long>(i));
  }
}

void Worker::HandleExecutorMessage(pb::FromExecutor& message) {
  const uint64_t token = message.has_progress()     ? message.progress().token()
                         : message.has_log()        ? message.log().token()
                         : message.has_checkpoint() ? message.checkpoint().token()
                         : message.has_finished()   ? message.finished().token()
                                                    : message.failed().token();
  const auto found = held_.find(token);
  if (found == held_.end()) return;
  Held& held = found->second;
  if (message.has_log()) {
    for (const pb::TaskLogLine& line : message.log().lines()) AddLog(token, line.text(), line.wall_ns());
  } else if (message.has_progress()) {
    pb::WorkerMessage out;
    *out.mutable_progress() = std::move(*message.mutable_progress());
    if (!held.revoked) Send(out);
  } else if (message.has_checkpoint()) {
    pb::WorkerMessage out;
    *out.mutable_checkpoint() = std::move(*message.mutable_checkpoint());
    if (!held.revoked) Send(out);
  } else if (message.has_finished() || message.has_failed()) {
    if (held.executor != nullptr) held.executor->SetIdle();
    held.executor = nullptr;
    held.deadline_ns = held.kill_at_ns = 0;
    if (held.revoked) return Forget(token);
    if (message.has_finished())
      return HandleExecutorFinished(token, held, std::move(*message.mutable_finished()));
    HandleExecutorFailed(held, message.failed());
  }
}

void Worker::HandleExecutorFinished(uint64_t token, Held& held, pb::ExecutorFinished finished) {
  troubles_ = 0;
  held.finished = std::move(finished);
  Upload(token, held);
}

void Worker::HandleExecutorFailed(Held& held, const pb::ExecutorFailed& failed) {
  for (const std::string& sha256 : failed.damaged_inputs()) cache_.Remove(sha256);
  if (failed.damaged_inputs_size() > 0) return GiveBackForNode(held, failed.error());
  if (failed.of_node()) return RestFromTrouble(held, failed.error());
  const auto outcome = held.timed_out ? pb::ATTEMPT_OUTCOME_TIMED_OUT : pb::ATTEMPT_OUTCOME_FAILED;
  const std::string prefix =
      held.timed_out ? "timed out after " + std::to_string(held.assignment.timeout_s()) + " s: " : "";
  ReportFailure(held, outcome, prefix + failed.error(), failed.retryable() || held.timed_out);
}

void Worker::HandleExecutorEnd(Executor& executor) {
  const auto found = held_.find(executor.token());
  if (found == held_.end()) return;
  Held& held = found->second;
  held.executor = nullptr;
  held.deadline_ns = held.kill_at_ns = 0;
  if (held.revoked) return Forget(found->first);
  if (held.timed_out) {
    return ReportFailure(held, pb::ATTEMPT_OUTCOME_TIMED_OUT,
                         "timed out after " + std::to_string(held.assignment.timeout_s()) + " s", true);
  }
  const std::string how = executor.HowItEnded();
  if (!executor.is_ready()) {  // it has run nothing
    held.stage = Stage::kQueued;
    return RestFromStarting("no executor comes up: " + how);
  }
  spdlog::warn("task {} of job {}: {}", held.assignment.name(), held.assignment.job(), how);
  ReportFailure(held, pb::ATTEMPT_OUTCOME_CRASHED, how, true);
}

// Asks the task to stop; EnforceDeadlines ends it if it does not.
void Worker::Interrupt(Held& held) {
  if (held.executor == nullptr || held.kill_at_ns > 0) return;
  held.executor->Cancel();
  const auto least = options_.least_grace_s.find(held.assignment.kind());
  const double grace_s =
      std::max(options_.cancel_grace_s, least == options_.least_grace_s.end() ? 0.0 : least->second);
  held.kill_at_ns = now() + static_cast<int64_t>(grace_s * kNsPerSecond);
}

void Worker::EnforceDeadlines() {
  for (auto& [token, held] : held_) {
    if (held.stage != Stage::kRunning || held.executor == nullptr) continue;
    if (held.deadline_ns > 0 && now() >= held.deadline_ns) {
      held.timed_out = true;
      held.deadline_ns = 0;
      Interrupt(held);
    }
    if (held.kill_at_ns > 0 && now() >= held.kill_at_ns) held.executor->Kill();
  }
}

// --- reporting ---------------------------------------------------------------------------------------------

// Uploads what is too large to travel with the report: all of it, or what the coordinator misses.
void Worker::Upload(uint64_t token, Held& held, const std::vector<std::string>& only) {
  held.stage = Stage::kUploading;
  held.next_send_ns = 0;
  held.open_transfers = 0;
  std::set<std::string> begun;
  for (const pb::ExecutorOutput& output : held.finished.outputs()) {
    const std::string& sha256 = output.output().sha256();
    if (output.path().empty() || !begun.insert(sha256).second) continue;
    if (!only.empty() && std::find(only.begin(), only.end(), sha256) == only.end()) continue;
    Transfer transfer{Transfer::Kind::kUpload, token, sha256, output.path(), {}, database_};
    transfer.info.set_sha256(sha256);
    transfer.info.set_kind(output.output().kind());
    transfer.info.set_size_bytes(output.output().size());
    transfer.info.set_metadata_json(output.output().metadata_json());
    transfer.info.set_job_id(std::to_string(held.assignment.job()));
    transfer.info.set_task_id(std::to_string(held.assignment.task()));
    std::set<std::string> parents(output.output().extra_parents().begin(),
                                  output.output().extra_parents().end());
    for (const auto& input : held.assignment.inputs()) parents.insert(input.sha256());
    for (const std::string& parent : parents) transfer.info.add_parents(parent);
    transfers_->Add(std::move(transfer));
    ++held.open_transfers;
  }
  if (held.open_transfers == 0) ReportFinished(held);
}

void Worker::ReportFinished(Held& held) {
  held.stage = Stage::kReporting;
  held.report.Clear();
  auto* finished = held.report.mutable_finished();
  finished->set_token(held.assignment.token());
  finished->set_task(held.assignment.task());
  finished->set_summary_json(held.finished.summary_json());
  finished->set_seconds(held.finished.seconds());
  finished->set_remark(held.finished.remark());
  for (const pb::ExecutorOutput& output : held.finished.outputs()) *finished->add_outputs() = output.output();
  held.next_send_ns = 1;  // at once, after its log
  logs_due_ns_ = 0;
}

void Worker::ReportFailure(Held& held, pb::AttemptOutcome outcome, const std::string& error, bool retryable) {
  transfers_->Drop(held.assignment.token());
  held.stage = Stage::kReporting;
  held.report.Clear();
  auto* failed = held.report.mutable_failed();
  failed->set_token(held.assignment.token());
  failed->set_task(held.assignment.task());
  failed->set_outcome(outcome);
  failed->set_error(error);
  failed->set_retryable(retryable);
  held.next_send_ns = 1;
  logs_due_ns_ = 0;
}

void Worker::GiveBackForNode(Held& held, const std::string& why) {
  ReportFailure(held, pb::ATTEMPT_OUTCOME_LOST, "given back: " + why, true);
  held.report.mutable_failed()->set_of_node(true);
}

// What has not run goes back as it came; what runs is broken off.
void Worker::GiveBackEverything(const std::string& why) {
  executors_.clear();
  draining_ = true;
  next_beat_ns_ = 0;
  SendBeatIfDue();  // or it would all come back at once
  for (auto& [token, held] : held_) {
    if (held.revoked) continue;
    const bool may_have_run = held.assignment.at_most_once() && held.stage == Stage::kRunning;
    if (held.stage != Stage::kReporting && !may_have_run) {
      ReportFailure(held, pb::ATTEMPT_OUTCOME_LOST, "given back: " + why, true);
    }
    if (held.stage == Stage::kReporting) Send(held.report);
  }
}

}  // namespace rg::worker
