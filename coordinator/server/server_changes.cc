// The part of the server that takes changes: jobs submitted and acted on, one or many at once, workers drained.
#include <algorithm>

#include "coordinator/server/job_compiler.h"
#include "coordinator/server/server.h"
#include "coordinator/server/views.h"

namespace rg::coordinator {
namespace {

using transport::MakeErrorReply;
using transport::MakeReply;
using transport::Unpack;

constexpr int kMaxAtOnce = 10'000;

Status StatusOf(const AnswerClient& answer) {
  switch (answer.verdict) {
    case Verdict::kOk:
      return Status::Ok();
    case Verdict::kNotFound:
      return NotFoundError(answer.error);
    case Verdict::kFailedPrecondition:
      return FailedPreconditionError(answer.error);
  }
  return Status::Ok();
}

Result<JobCommand> CommandOf(pb::JobAction action) {
  switch (action) {
    case pb::JOB_ACTION_CANCEL:
      return JobCommand::kCancel;
    case pb::JOB_ACTION_PAUSE:
      return JobCommand::kPause;
    case pb::JOB_ACTION_RESUME:
      return JobCommand::kResume;
    case pb::JOB_ACTION_RETRY:
      return JobCommand::kRetry;
    case pb::JOB_ACTION_PRIORITY:
      return JobCommand::kPriority;
    default:
      return InvalidError("unknown action");
  }
}

Status CheckHowMany(int count) {
  if (count <= kMaxAtOnce) return Status::Ok();
  return ResourceExhaustedError(std::to_string(count) + " at once are more than " + std::to_string(kMaxAtOnce));
}

}  // namespace

// Who is refused again and again is one event a second.
void Server::Refuse(const transport::Message& message, const Status& why) {
  Reply(MakeErrorReply(self_, message, why));
  if (why.code() != StatusCode::kPermissionDenied || !trouble_.empty()) return;
  constexpr int64_t kEveryNs = 1'000'000'000;
  const std::string& who = message.credentials.name;
  const auto [noted, is_first] = refusal_noted_ns_.try_emplace(who, clock_->SteadyNanos());
  if (!is_first && clock_->SteadyNanos() - noted->second < kEveryNs) return;
  noted->second = clock_->SteadyNanos();
  const std::string by = who.empty() ? std::string(transport::RoleName(message.credentials.role)) : who;
  actions_.rows.emplace_back(AppendEvent{clock_->WallNanos(), 0, "", "", "request.refused", "by " + by + ": " + why.message()});
}

// --- submits -----------------------------------------------------------------------------------------------

std::string Server::KindOf(TaskId task) const {
  return task == 0 ? "" : state_.jobs.at(JobOf(task)).plan_of(IndexOf(task)).kind;
}

void Server::HandleSubmit(const transport::Message& message) {
  auto body = Unpack<pb::SubmitRequest>(message);
  if (!body.ok()) return Reply(MakeErrorReply(self_, message, body.status()));
  auto event = ToSubmit(message, &*body);
  if (!event.ok()) return Refuse(message, event.status());
  event->reply_to = ++last_reply_;
  pending_[event->reply_to] = {message, PendingReply::Asked::kSubmit};
  Absorb(*event, state_, now(), actions_);
}

void Server::HandleManySubmits(const transport::Message& message) {
  auto body = Unpack<pb::SubmitManyRequest>(message);
  const Status sensible = body.ok() ? CheckHowMany(body->submits_size()) : body.status();
  if (!sensible.ok()) return Reply(MakeErrorReply(self_, message, sensible));
  const auto many = std::make_shared<Many>(Many{message, {}, {}, body->submits_size()});
  for (int i = 0; i < body->submits_size(); ++i) {
    many->submits.add_jobs(0);
    many->submits.add_errors();
    auto event = ToSubmit(message, body->mutable_submits(i));
    if (!event.ok()) {
      many->submits.set_errors(i, event.status().message());
      --many->left;
      continue;
    }
    event->reply_to = ++last_reply_;
    pending_[event->reply_to] = {{}, PendingReply::Asked::kSubmit, many, i};
    Absorb(*event, state_, now(), actions_);
  }
  if (many->left == 0) Reply(MakeReply(self_, message, many->submits));
}

Result<Submit> Server::ToSubmit(const transport::Message& message, pb::SubmitRequest* body) {
  if (body->request_id().empty()) return InvalidError("a submit needs a request id");
  pb::JobSpec& spec = *body->mutable_job();
  RG_ASSIGN_OR_RETURN(const TaskId parent, TaskAsking(message));
  RG_RETURN_IF_ERROR(CheckSubmit(options_.policy, message.credentials, KindOf(parent), spec));
  Submit event;
  event.request_id = body->request_id();
  event.content = ContentOf(spec);
  spec.set_submitted_by(NameOf(message.credentials, spec.submitted_by()));
  if (parent != 0) {
    const Job& job = state_.jobs.at(JobOf(parent));
    event.request_id = "task " + std::to_string(parent) + ": " + event.request_id;
    event.lease = message.envelope.fencing_token();
    spec.set_priority(std::clamp(job.priority_of(IndexOf(parent)), -kMaxPriority, kMaxPriority));
    spec.set_submitted_by("task " + job.plan_of(IndexOf(parent)).name + " of job " + std::to_string(job.id));
  }
  const auto over = jobs_->FindRequest(event.request_id);
  if (over.ok()) {
    event.known = over->job;
    event.known_content = over->plan->content;
  } else if (over.status().code() != StatusCode::kNotFound) {
    return over.status();
  }
  if (event.known == 0 && state_.job_by_request.count(event.request_id) == 0)
    RG_RETURN_IF_ERROR(CompileInto(spec, parent, &event));
  return event;
}

Status Server::CompileInto(const pb::JobSpec& spec, TaskId parent, Submit* event) {
  RG_ASSIGN_OR_RETURN(const CompiledJob compiled, CompileJob(spec, parent, options_.policy.robot_kinds));
  RG_RETURN_IF_ERROR(worker_desk_->CheckArtifactsExist(spec));
  RG_ASSIGN_OR_RETURN(event->unmet, FindUnmet(*compiled.plan));
  auto plan = std::make_shared<JobPlan>(*compiled.plan);
  plan->content = event->content;
  event->plan = std::move(plan);
  event->specs = compiled.specs;
  return Status::Ok();
}

// Of the jobs that it comes after, one that has left memory without success; 0: none. kNotFound: there never
// was such a job.
Result<JobId> Server::FindUnmet(const JobPlan& plan) {
  for (const JobId id : plan.after_jobs) {
    if (state_.FindJob(id) != nullptr) continue;
    RG_ASSIGN_OR_RETURN(const JobRow row, jobs_->FindJob(id));
    if (row.record.phase != JobPhase::kSucceeded) return id;
  }
  return JobId{0};
}

Result<TaskId> Server::TaskAsking(const transport::Message& message) const {
  if (message.credentials.role != pb::ROLE_WORKER && message.credentials.role != pb::ROLE_AGENT) return TaskId{0};
  const Token token = message.envelope.fencing_token();
  const auto lease = state_.leases.find(token);
  if (lease != state_.leases.end() && state_.Holds(lease->second.task, token)) {
    const auto peer = peer_by_instance_.find(lease->second.instance);
    if (peer != peer_by_instance_.end() && peer->second.key_name == message.credentials.name)
      return lease->second.task;
  }
  return FailedPreconditionError("the lease " + std::to_string(token) + " is no longer valid");
}

// --- actions -----------------------------------------------------------------------------------------------

void Server::HandleAction(const transport::Message& message) {
  auto body = Unpack<pb::JobActionRequest>(message);
  if (!body.ok()) return Reply(MakeErrorReply(self_, message, body.status()));
  auto event = ToCommand(message, *body);
  if (!event.ok()) return Refuse(message, event.status());
  event->reply_to = ++last_reply_;
  pending_[event->reply_to] = {message, PendingReply::Asked::kAction};
  Absorb(*event, state_, now(), actions_);
}

void Server::HandleManyActions(const transport::Message& message) {
  const auto body = Unpack<pb::ManyJobActionsRequest>(message);
  const Status sensible = body.ok() ? CheckHowMany(body->actions_size()) : body.status();
  if (!sensible.ok()) return Reply(MakeErrorReply(self_, message, sensible));
  const auto many = std::make_shared<Many>(Many{message, {}, {}, body->actions_size()});
  for (int i = 0; i < body->actions_size(); ++i) {
    many->actions.add_jobs()->set_id(body->actions(i).job());
    many->actions.add_errors();
    auto event = ToCommand(message, body->actions(i));
    if (!event.ok()) {
      many->actions.set_errors(i, event.status().message());
      --many->left;
      continue;
    }
    event->reply_to = ++last_reply_;
    pending_[event->reply_to] = {{}, PendingReply::Asked::kAction, many, i};
    Absorb(*event, state_, now(), actions_);
  }
  if (many->left == 0) Reply(MakeReply(self_, message, many->actions));
}

Result<CommandJob> Server::ToCommand(const transport::Message& message, const pb::JobActionRequest& body) {
  CommandJob event;
  RG_ASSIGN_OR_RETURN(const TaskId task, TaskAsking(message));
  RG_ASSIGN_OR_RETURN(event.command, CommandOf(body.action()));
  RG_ASSIGN_OR_RETURN(event.job, MeantJob(body.job()));
  RG_ASSIGN_OR_RETURN(const Job* job, BringBack(event.job, event.command == JobCommand::kRetry));
  if (task != 0 && (job->plan->parent != task || event.command != JobCommand::kCancel))
    return PermissionDeniedError("a task may cancel what it has submitted, and nothing else");
  RG_RETURN_IF_ERROR(CheckPlain("the reason", body.reason()));
  RG_RETURN_IF_ERROR(CheckPlain("who asks", body.by()));
  if (task == 0 && event.command != JobCommand::kPause)
    RG_RETURN_IF_ERROR(CheckAction(options_.policy, message.credentials, *job->plan));
  if (event.command == JobCommand::kRetry) {
    RG_ASSIGN_OR_RETURN(event.unmet, FindUnmet(*job->plan));
  }
  if (event.command == JobCommand::kPriority) RG_RETURN_IF_ERROR(CheckPriority(body.priority()));
  event.priority = body.priority();
  event.reason = body.reason();
  if (task == 0) event.by = NameOf(message.credentials, body.by());
  return event;
}

void Server::HandleDrain(const transport::Message& message) {
  auto body = Unpack<pb::DrainWorkerRequest>(message);
  const Status plain = body.ok() ? CheckPlain("the reason", body->reason()) : body.status();
  if (!plain.ok()) return Reply(MakeErrorReply(self_, message, plain));
  const ReplyTo reply_to = ++last_reply_;
  pending_[reply_to] = {message, PendingReply::Asked::kDrain};
  Absorb(DrainWorker{body->worker(), reply_to, NameOf(message.credentials, ""), body->reason()}, state_, now(), actions_);
}

// Whoever sees the arm may hold it; that it moves again is for those who may move it.
void Server::HandleHold(const transport::Message& message) {
  const auto body = Unpack<pb::HoldRobotRequest>(message);
  Status good = body.ok() ? CheckPlain("the reason", body->reason()) : body.status();
  if (good.ok()) good = CheckPlain("the robot", body->robot());
  if (good.ok() && body->robot().empty()) good = InvalidError("which robot?");
  if (!good.ok()) return Reply(MakeErrorReply(self_, message, good));
  if (body->release() && !message.credentials.may_move_robots())
    return Refuse(message, PermissionDeniedError("to release a robot needs the right to robots"));
  const ReplyTo reply_to = ++last_reply_;
  pending_[reply_to] = {message, PendingReply::Asked::kHold};
  Absorb(HoldRobot{body->robot(), body->reason(), NameOf(message.credentials, body->by()), body->release(), reply_to},
         state_, now(), actions_);
}

// --- answers -----------------------------------------------------------------------------------------------

void Server::Translate(const AnswerClient& m) {
  const auto found = pending_.find(m.reply_to);
  if (found == pending_.end()) return;
  const PendingReply pending = std::move(found->second);
  pending_.erase(found);
  if (pending.many != nullptr) return AnswerOneOf(*pending.many, pending.index, pending.asked == PendingReply::Asked::kSubmit, m);
  const Status status = StatusOf(m);
  if (!status.ok()) return Reply(MakeErrorReply(self_, pending.request, status));
  if (pending.asked == PendingReply::Asked::kSubmit) {
    pb::SubmitReply reply;
    reply.set_job(m.job);
    reply.set_already_known(m.already_known);
    return Reply(MakeReply(self_, pending.request, reply));
  }
  if (pending.asked == PendingReply::Asked::kHold) return Reply(MakeReply(self_, pending.request, pb::HoldRobotReply()));
  if (pending.asked == PendingReply::Asked::kDrain) return Reply(MakeReply(self_, pending.request, pb::DrainWorkerReply()));
  pb::JobActionReply reply;
  *reply.mutable_job() = Summary(m.job);
  Reply(MakeReply(self_, pending.request, reply));
}

void Server::AnswerOneOf(Many& many, int index, bool is_submit, const AnswerClient& answer) {
  const Status status = StatusOf(answer);
  if (is_submit && status.ok()) many.submits.set_jobs(index, answer.job);
  if (is_submit) many.submits.set_errors(index, status.message());
  if (!is_submit && status.ok()) *many.actions.mutable_jobs(index) = Summary(answer.job);
  if (!is_submit) many.actions.set_errors(index, status.message());
  if (--many.left > 0) return;
  Reply(is_submit ? MakeReply(self_, many.request, many.submits) : MakeReply(self_, many.request, many.actions));
}

}  // namespace rg::coordinator
