#include "coordinator/server/worker_desk.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "common/base/hash.h"
#include "common/base/utf8.h"
#include "coordinator/server/artifact_desk.h"

namespace rg::coordinator {
namespace {

constexpr size_t kMaxSummaryBytes = 64 << 10;
constexpr size_t kMaxErrorBytes = 4 << 10;

std::string Shortened(const std::string& text) {
  return text.size() <= kMaxErrorBytes ? text : CleanUtf8(text, kMaxErrorBytes) + " …";
}

WorkerJoined FromHello(const pb::WorkerHello& hello, const std::string& instance) {
  WorkerJoined event;
  event.name = hello.name();
  event.instance = instance;
  event.slots = hello.slots();
  event.tags.assign(hello.tags().begin(), hello.tags().end());
  event.kinds.assign(hello.kinds().begin(), hello.kinds().end());
  event.held.assign(hello.held_tokens().begin(), hello.held_tokens().end());
  event.draining = hello.draining();
  event.host = hello.host();
  event.pid = hello.pid();
  event.version = hello.version();
  event.unable = VisibleText(Shortened(hello.unable()));
  return event;
}

Outcome FromWire(pb::AttemptOutcome outcome) {
  switch (outcome) {
    case pb::ATTEMPT_OUTCOME_CRASHED:
      return Outcome::kCrashed;
    case pb::ATTEMPT_OUTCOME_TIMED_OUT:
      return Outcome::kTimedOut;
    case pb::ATTEMPT_OUTCOME_LOST:
      return Outcome::kLost;
    case pb::ATTEMPT_OUTCOME_CANCELLED:
      return Outcome::kCancelled;
    default:
      return Outcome::kFailed;
  }
}

}  // namespace

std::optional<Event> WorkerDesk::ToEvent(const pb::WorkerMessage& message, const std::string& instance) {
  switch (message.message_case()) {
    case pb::WorkerMessage::kHello:
      if (message.hello().name().empty()) return std::nullopt;
      return FromHello(message.hello(), instance);
    case pb::WorkerMessage::kHeartbeat: {
      const auto& beat = message.heartbeat();
      return WorkerBeat{instance,
                        {beat.held_tokens().begin(), beat.held_tokens().end()},
                        beat.draining(),
                        {beat.finished_tokens().begin(), beat.finished_tokens().end()},
                        VisibleText(Shortened(beat.unable())),
                        {beat.disk_free_bytes(), beat.memory_free_bytes(), std::isfinite(beat.load()) ? beat.load() : 0.0,
                         VisibleText(Shortened(beat.robot_state()))}};
    }
    case pb::WorkerMessage::kBye:
      return WorkerLeft{instance};
    case pb::WorkerMessage::kStartRequest:
      return StartRequested{instance, message.start_request().token()};
    case pb::WorkerMessage::kProgress: {
      const auto& p = message.progress().progress();
      const bool sensible = std::isfinite(p.done()) && std::isfinite(p.total());
      return Progressed{instance, message.progress().token(), p.stage(), sensible ? p.done() : 0.0,
                        sensible ? p.total() : 0.0, Shortened(p.note())};
    }
    case pb::WorkerMessage::kFailed: {
      const auto& f = message.failed();
      return Failed{instance,     f.task(), f.token(), FromWire(f.outcome()), Shortened(f.error()),
                    f.retryable(), f.of_node()};
    }
    default:
      return std::nullopt;
  }
}

Finished WorkerDesk::ToFinished(const pb::TaskFinished& finished, const std::string& instance) {
  Finished event{instance, finished.task(), finished.token()};
  event.remark = VisibleText(Shortened(finished.remark()));
  return event;
}

// --- results -----------------------------------------------------------------------------------------

std::vector<std::string> WorkerDesk::MissingOutputs(const pb::TaskFinished& finished) {
  std::vector<std::string> missing;
  for (const pb::TaskOutput& output : finished.outputs()) {
    const bool here =
        !output.inline_bytes().empty() || output.size() == 0 || artifacts_->Contains(output.sha256());
    if (!here) missing.push_back(output.sha256());
  }
  return missing;
}

Result<ResultRow> WorkerDesk::StoreOutputs(const State& state, const Lease& lease,
                                           const pb::TaskFinished& finished) {
  ResultRow result;
  // A number that is none would be no number in the database either, which wants one.
  result.seconds = std::isfinite(finished.seconds()) ? std::max(0.0, finished.seconds()) : 0.0;
  if (!finished.summary_json().empty()) result.summary_json = finished.summary_json();
  if (result.summary_json.size() > kMaxSummaryBytes) {
    return InvalidError("summary of " + std::to_string(result.summary_json.size()) +
                        " bytes is above the limit of " + std::to_string(kMaxSummaryBytes));
  }
  std::vector<std::string> parents;
  if (finished.outputs_size() > 0) {
    RG_ASSIGN_OR_RETURN(const std::string bytes, jobs_->Spec(lease.task));
    pb::TaskSpec spec;
    if (!spec.ParseFromString(bytes)) return DataLossError("the task's specification does not parse");
    RG_ASSIGN_OR_RETURN(const auto inputs,
                        ResolveInputs(*state.FindJob(JobOf(lease.task)), IndexOf(lease.task), spec));
    for (const pb::ResolvedInput& input : inputs) parents.push_back(input.sha256());
  }
  RG_ASSIGN_OR_RETURN(auto savepoint, database_->Begin());
  std::set<std::string> names;
  for (const pb::TaskOutput& output : finished.outputs()) {
    if (!names.insert(output.name()).second)
      return InvalidError("two outputs are named '" + output.name() + "'");
    auto row = StoreOutput(lease.task, parents, output);
    if (!row.ok()) return row.status().WithPrefix("output '" + output.name() + "'");
    result.outputs.push_back(*std::move(row));
  }
  RG_RETURN_IF_ERROR(savepoint.Commit());
  return result;
}

Result<OutputRow> WorkerDesk::StoreOutput(TaskId task, const std::vector<std::string>& parents,
                                          const pb::TaskOutput& output) {
  OutputRow row{output.name(), output.kind(), output.sha256(), output.metadata_json(),
                static_cast<int64_t>(output.size())};
  if (row.metadata_json.empty()) row.metadata_json = "{}";
  const bool travels_along = !output.inline_bytes().empty() || output.size() == 0;
  if (travels_along) {
    if (Sha256Hex(output.inline_bytes()) != output.sha256())
      return DataLossError("the bytes do not match the hash");
    store::ArtifactSpec spec;
    spec.kind = output.kind();
    spec.metadata_json = row.metadata_json;
    spec.job_id = std::to_string(JobOf(task));
    spec.task_id = std::to_string(task);
    std::set<std::string> all(parents.begin(), parents.end());
    all.insert(output.extra_parents().begin(), output.extra_parents().end());
    all.erase(output.sha256());
    spec.parents.assign(all.begin(), all.end());
    const Status put = artifacts_->Put(output.inline_bytes(), spec).status();
    // The same bytes may be there as another kind: they are here, which is what children need; the
    // task's own row keeps the kind it gave them.
    if (!put.ok() && !artifacts_->Contains(output.sha256())) return put;
  }
  if (output.kind() == "parameters") RG_RETURN_IF_ERROR(AddParameters(task, output));
  return row;
}

Status WorkerDesk::AddParameters(TaskId task, const pb::TaskOutput& output) {
  RG_ASSIGN_OR_RETURN(auto version, ParseParameterMetadata(output.metadata_json()));
  version.job_id = std::to_string(JobOf(task));
  return parameters_->Add(version, std::to_string(task) + "/" + output.name()).status();
}

// --- assignments -------------------------------------------------------------------------------------

Result<pb::TaskAssignment> WorkerDesk::Assemble(const State& state, const Assign& assign) {
  const Job* job = state.FindJob(JobOf(assign.task));
  if (job == nullptr) return NotFoundError("its job is gone");
  RG_ASSIGN_OR_RETURN(const std::string bytes, jobs_->Spec(assign.task));
  pb::TaskSpec spec;
  if (!spec.ParseFromString(bytes)) return DataLossError("the task's specification does not parse");
  pb::TaskAssignment out;
  out.set_task(assign.task);
  out.set_job(job->id);
  out.set_attempt(assign.attempt);
  out.set_token(assign.token);
  out.set_name(spec.name());
  out.set_kind(spec.kind());
  out.set_payload(spec.payload());
  out.set_at_most_once(job->plan_of(IndexOf(assign.task)).at_most_once);
  out.set_timeout_s(spec.timeout_s());
  out.set_job_name(job->plan->name);
  out.set_database(database_->identity());
  RG_ASSIGN_OR_RETURN(auto inputs, ResolveInputs(*job, IndexOf(assign.task), spec));
  for (pb::ResolvedInput& input : inputs) *out.add_inputs() = std::move(input);
  if (assign.attempt > 1) {
    RG_ASSIGN_OR_RETURN(*out.mutable_checkpoint(), jobs_->Checkpoint(assign.task));
  }
  return out;
}

Result<std::vector<pb::ResolvedInput>> WorkerDesk::ResolveInputs(const Job& job, uint32_t index,
                                                                 const pb::TaskSpec& spec) {
  std::vector<pb::ResolvedInput> resolved;
  for (const pb::InputSpec& input : spec.inputs()) {
    const Status status = ResolveInput(job, index, input, &resolved);
    if (!status.ok()) return status.WithPrefix("input '" + input.name() + "'");
  }
  return resolved;
}

Status WorkerDesk::ResolveInput(const Job& job, uint32_t index, const pb::InputSpec& input,
                                std::vector<pb::ResolvedInput>* resolved) {
  if (input.source_case() == pb::InputSpec::kArtifact) return ResolveArtifact(input, resolved);
  const bool is_stage = input.source_case() == pb::InputSpec::kStageOutputs;
  const std::string& output = is_stage ? input.stage_outputs().output() : input.task_output().output();
  for (const ParentEdge& edge : job.plan_of(index).parents) {  // in the order of the job's tasks
    const TaskPlan& parent = job.plan_of(edge.parent);
    const bool is_meant =
        is_stage ? parent.stage == input.stage_outputs().stage() : parent.name == input.task_output().task();
    if (!is_meant) continue;
    RG_RETURN_IF_ERROR(
        ResolveTaskOutputs(job, edge.parent, output, is_stage && output.empty(), input, resolved));
  }
  return Status::Ok();
}

Status WorkerDesk::ResolveArtifact(const pb::InputSpec& input, std::vector<pb::ResolvedInput>* resolved) {
  auto info = artifacts_->Info(input.artifact());
  if (!info.ok() && input.optional() && info.status().code() == StatusCode::kNotFound) return Status::Ok();
  if (!info.ok()) return info.status();
  pb::ResolvedInput& out = resolved->emplace_back();
  out.set_name(input.name());
  out.set_sha256(info->sha256);
  out.set_kind(info->kind);
  out.set_size(static_cast<uint64_t>(info->size_bytes));
  out.set_metadata_json(info->metadata_json);
  return Status::Ok();
}

Status WorkerDesk::ResolveTaskOutputs(const Job& job, uint32_t parent, const std::string& output,
                                      bool all_outputs, const pb::InputSpec& input,
                                      std::vector<pb::ResolvedInput>* resolved) {
  const bool committed = std::holds_alternative<TaskSucceeded>(job.tasks[parent].status);
  if (!committed && input.optional()) return Status::Ok();
  RG_ASSIGN_OR_RETURN(const auto rows, jobs_->Outputs(MakeTaskId(job.id, parent)));
  bool found = false;
  for (const OutputRow& row : rows) {
    if (!all_outputs && row.name != output) continue;
    found = true;
    pb::ResolvedInput& out = resolved->emplace_back();
    out.set_name(input.name());
    out.set_sha256(row.sha256);
    out.set_kind(row.kind);
    out.set_size(static_cast<uint64_t>(row.size));
    out.set_metadata_json(row.metadata_json);
    out.set_from_task(job.plan_of(parent).name);
    out.set_from_output(row.name);
  }
  if (found || all_outputs || input.optional()) return Status::Ok();
  return NotFoundError("task '" + job.plan_of(parent).name + "' made no output '" + output + "'");
}

Status WorkerDesk::CheckArtifactsExist(const pb::JobSpec& spec) {
  for (const pb::TaskSpec& task : spec.tasks()) {
    for (const pb::InputSpec& input : task.inputs()) {
      if (input.source_case() != pb::InputSpec::kArtifact || input.optional()) continue;
      if (!artifacts_->Contains(input.artifact())) {
        return NotFoundError("task '" + task.name() + "': input '" + input.name() + "': artefact " +
                             input.artifact() + " is not stored here");
      }
    }
  }
  return Status::Ok();
}

}  // namespace rg::coordinator
