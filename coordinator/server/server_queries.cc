// The part of the server that answers clients.
#include <algorithm>

#include "coordinator/core/explain.h"
#include "coordinator/server/demand.h"
#include "coordinator/server/history.h"
#include "coordinator/server/past_jobs.h"
#include "coordinator/server/server.h"
#include "coordinator/server/views.h"

namespace rg::coordinator {
namespace {

using transport::Is;
using transport::MakeErrorReply;
using transport::MakeReply;
using transport::Unpack;

constexpr uint32_t kMaxWaitMs = 60'000;
constexpr size_t kMaxWatchers = 1'000;
constexpr int64_t kCalmNs = 100'000'000;

int LimitOf(uint32_t asked, int normally) {
  return asked == 0 ? normally : static_cast<int>(std::min(asked, 1'000'000u));
}

template <class Body, class Function>
transport::Message Serve(const transport::Sender& self, const transport::Message& message,
                         Function function) {
  auto body = Unpack<Body>(message);
  if (!body.ok()) return MakeErrorReply(self, message, body.status());
  auto reply = function(*body);
  if (!reply.ok()) return MakeErrorReply(self, message, reply.status());
  return MakeReply(self, message, *reply);
}

}  // namespace

void Server::HandleRequest(transport::Message message) {
  const Status allowed = CheckRequest(message);
  if (!allowed.ok()) return Refuse(message, allowed);
  const bool is_job = Is<pb::SubmitRequest>(message) || Is<pb::JobActionRequest>(message) ||
                      Is<pb::SubmitManyRequest>(message) || Is<pb::ManyJobActionsRequest>(message);
  const bool is_change = is_job || Is<pb::DrainWorkerRequest>(message) || Is<pb::HoldRobotRequest>(message) || ArtifactDesk::Writes(message) ||
                         Is<pb::ArchiveJobsRequest>(message);
  if (is_change && !trouble_.empty() && !MayFreeSpace(message)) return Reply(MakeErrorReply(self_, message, Trouble()));
  if (Is<pb::SubmitRequest>(message)) return HandleSubmit(message);
  if (Is<pb::SubmitManyRequest>(message)) return HandleManySubmits(message);
  if (Is<pb::ManyJobActionsRequest>(message)) return HandleManyActions(message);
  if (Is<pb::JobActionRequest>(message)) return HandleAction(message);
  if (Is<pb::DrainWorkerRequest>(message)) return HandleDrain(message);
  if (Is<pb::HoldRobotRequest>(message)) return HandleHold(message);
  if (ArtifactDesk::Writes(message)) return HandleWrite(message);
  if (Is<pb::ArchiveJobsRequest>(message)) return HandleArchive(message);
  if (Is<pb::GetLogsRequest>(message) && !NameTheJob<pb::GetLogsRequest>(message)) return;
  if (Is<pb::GetJobRequest>(message) && !NameTheJob<pb::GetJobRequest>(message)) return;
  if (Is<pb::ExplainRequest>(message) && !NameTheJob<pb::ExplainRequest>(message)) return;
  if (LeaveToReaders(message)) return;
  if (Is<pb::GetJobRequest>(message) && watchers_.size() < kMaxWatchers) {
    auto body = Unpack<pb::GetJobRequest>(message);
    if (body.ok() && body->wait_ms() > 0) {
      const int64_t wait_ns = int64_t{std::min(body->wait_ms(), kMaxWaitMs)} * 1'000'000;
      watchers_.push_back({std::move(message), *std::move(body), clock_->SteadyNanos() + kCalmNs,
                           clock_->SteadyNanos() + wait_ns});
      return;
    }
  }
  queries_.push_back(std::move(message));
}

bool Server::MayFreeSpace(const transport::Message& message) {
  const auto action = Unpack<pb::JobActionRequest>(message);
  const auto actions = Unpack<pb::ManyJobActionsRequest>(message);
  const bool cancels = action.ok() && action->action() == pb::JOB_ACTION_CANCEL;
  const bool cancels_many = actions.ok() && std::all_of(actions->actions().begin(), actions->actions().end(), [](const auto& one) {
                              return one.action() == pb::JOB_ACTION_CANCEL;
                            });
  const bool frees = cancels || cancels_many || Is<pb::GcArtifactsRequest>(message) ||
                     Is<pb::ArchiveJobsRequest>(message) || Is<pb::DrainWorkerRequest>(message) ||
                     Is<pb::HoldRobotRequest>(message);
  if (!frees) return false;
  reserve_->GiveUp();
  return frees_space_ = true;
}

void Server::HandleWrite(const transport::Message& message) {
  const Status begun = EnsureTransaction();
  if (!begun.ok()) return Reply(MakeErrorReply(self_, message, begun));
  promises_.push_back(*artifact_desk_->Answer(self_, message));
  if (Is<pb::PromoteParametersRequest>(message) && transport::ReplyStatus(promises_.back()).ok()) NotePromotion(message);
  space_was_freed_ = space_was_freed_ || Is<pb::GcArtifactsRequest>(message);
}

void Server::NotePromotion(const transport::Message& message) {
  const auto body = Unpack<pb::PromoteParametersRequest>(message);
  if (!body.ok()) return;
  const std::string who = NameOf(message.credentials, body->by());
  const std::string which = body->version() == 0 ? "the latest" : "version " + std::to_string(body->version());
  actions_.rows.emplace_back(AppendEvent{clock_->WallNanos(), 0, "", "", "parameters.promoted",
                                         (who.empty() ? "" : "by " + who + ": ") + which + " of " + body->robot()});
}

Result<JobId> Server::MeantJob(JobId id) const {
  if (id != 0) return id;
  if (state_.newest_of_clients != 0) return state_.newest_of_clients;
  return NotFoundError("there is no job yet");
}

// "The newest job" is known here, and whether there is such a job; readers know the database only.
template <class Body>
bool Server::NameTheJob(transport::Message& message) {
  auto body = Unpack<Body>(message);
  auto job = body.ok() ? MeantJob(body->job()) : Result<JobId>(body.status());
  if (job.ok() && state_.FindJob(*job) == nullptr) {
    const auto row = jobs_->FindJob(*job);
    if (!row.ok()) job = row.status();
  }
  if (!job.ok()) return Reply(MakeErrorReply(self_, message, job.status())), false;
  body->set_job(*job);
  body->SerializeToString(message.envelope.mutable_payload());
  return true;
}

// A job that is over is told from its rows.
bool Server::IsOfThePast(const transport::Message& message) const {
  JobId job = 0;
  if (const auto show = Unpack<pb::GetJobRequest>(message); show.ok()) job = show->job();
  if (const auto explain = Unpack<pb::ExplainRequest>(message); explain.ok()) job = explain->job();
  return job != 0 && state_.FindJob(job) == nullptr;
}

bool Server::LeaveToReaders(transport::Message& message) {
  ReadDesk* desk = ReadDesk::IsLong(message)    ? long_reads_.get()
                   : ReadDesk::IsShort(message) ? short_reads_.get()
                   : IsOfThePast(message)       ? short_reads_.get()
                                                : nullptr;
  if (desk == nullptr) return false;
  const transport::Message head = MakeErrorReply(self_, message, Status::Ok());  // peer and id, for a refusal
  const Status added = desk->Add(std::move(message));
  if (!added.ok()) Reply(MakeErrorReply(self_, head, added));
  return true;
}

void Server::TakeReaderAnswers() {
  for (ReadDesk* desk : {short_reads_.get(), long_reads_.get()}) {
    if (desk == nullptr) continue;
    for (transport::Message& answer : desk->TakeAnswers()) Reply(std::move(answer));
  }
}

// --- queries: after the commit, so that what they show is durable ---------------------------------------

transport::Message Server::AnswerQuery(const transport::Message& message) {
  if (Is<pb::GetJobRequest>(message)) {
    return Serve<pb::GetJobRequest>(self_, message, [this](const auto& b) { return GetJob(b); });
  }
  if (Is<pb::ListJobsRequest>(message)) {
    return Serve<pb::ListJobsRequest>(self_, message, [&](const auto& b) { return ListJobs(b, message.credentials); });
  }
  if (Is<pb::GetLogsRequest>(message)) {
    return Serve<pb::GetLogsRequest>(
        self_, message, [this](const auto& b) { return ReadLogs(*jobs_, b, options_.page_bytes); });
  }
  if (Is<pb::ListWorkersRequest>(message)) {
    return Serve<pb::ListWorkersRequest>(self_, message, [this](const auto& b) { return ListWorkers(b); });
  }
  if (Is<pb::ExplainRequest>(message)) {
    return Serve<pb::ExplainRequest>(self_, message, [this](const auto& b) { return ExplainTask(b); });
  }
  if (Is<pb::ListEventsRequest>(message)) {
    return Serve<pb::ListEventsRequest>(
        self_, message, [this](const auto& b) { return ReadEvents(*jobs_, b, options_.page_bytes); });
  }
  if (Is<pb::StatusRequest>(message)) {
    return Serve<pb::StatusRequest>(self_, message, [this](const auto& b) { return DescribeSelf(b); });
  }
  if (Is<pb::BackupRequest>(message))
    return MakeErrorReply(self_, message, FailedPreconditionError("the database is in memory"));
  if (auto reply = artifact_desk_->Answer(self_, message)) return *std::move(reply);
  return MakeErrorReply(self_, message,
                        InvalidError("a coordinator does not answer " + message.envelope.type()));
}

pb::JobSummary Server::Summary(JobId id) {
  const Job* job = state_.FindJob(id);
  if (job != nullptr && !job->tasks.empty()) return SummaryOf(*job, 0.0, clock_->WallNanos());
  const auto row = jobs_->FindJob(id);
  return row.ok() ? SummaryOf(*row) : pb::JobSummary();
}

// Rows tell which jobs there are; of those in memory, which are not over, it tells more.
Result<pb::ListJobsReply> Server::ListJobs(const pb::ListJobsRequest& request,
                                            const transport::Credentials& who) {
  const auto under_way = WeightUnderWay(state_);
  const int limit = LimitOf(request.limit(), 100);
  const auto labelled = [&](const JobPlan& plan) {
    return std::all_of(request.labels().begin(), request.labels().end(), [&](const auto& label) {
      const auto found = plan.labels.find(label.first);
      return found != plan.labels.end() && (label.second.empty() || label.second == found->second);
    });
  };
  JobFilter filter;
  filter.ids.assign(request.ids().begin(), request.ids().end());
  for (const int state : request.states()) filter.phases.push_back(static_cast<JobPhase>(state));
  filter.parent_job = request.parent_job();
  filter.before = request.before_id();
  filter.since_ns = request.since_ns();
  filter.by = request.mine() && !who.name.empty() ? who.name : request.by();
  pb::ListJobsReply reply;
  reply.set_you(who.name);
  size_t bytes = 0;
  RG_RETURN_IF_ERROR(jobs_->ListJobs(filter, [&](const JobRow& row) {
    if (!labelled(*row.plan)) return true;
    if (reply.jobs_size() >= limit || bytes > options_.page_bytes) return reply.set_more(true), false;
    const Job* job = state_.FindJob(row.job);
    const auto weight = under_way.find(row.job);
    *reply.add_jobs() =
        job == nullptr || IsFinal(job->record.phase)
            ? SummaryOf(row)
            : LiveSummary(*job, weight == under_way.end() ? 0.0 : weight->second);
    bytes += reply.jobs(reply.jobs_size() - 1).ByteSizeLong();
    return true;
  }));
  return reply;
}

pb::JobSummary Server::LiveSummary(const Job& job, double weight_under_way) const {
  pb::JobSummary summary = SummaryOf(job, weight_under_way, clock_->WallNanos());
  if (summary.reason().empty()) summary.set_reason(WhyItWaits(state_, job));
  return summary;
}

// Counted once per batch, however many watch the job.
const pb::GetJobReply& Server::OverviewOf(const Job& job) {
  const auto [known, is_new] = overviews_.try_emplace(job.id);
  pb::GetJobReply& overview = known->second;
  if (!is_new) return overview;
  const auto under_way = WeightUnderWay(state_);
  const auto weight = under_way.find(job.id);
  *overview.mutable_job() = LiveSummary(job, weight == under_way.end() ? 0.0 : weight->second);
  overview.set_spec_json(job.plan->spec_json);
  FillStages(state_, job, &overview);
  return overview;
}

Result<pb::GetJobReply> Server::GetJob(const pb::GetJobRequest& request) {
  RG_ASSIGN_OR_RETURN(const JobId id, MeantJob(request.job()));
  const Job* job = state_.FindJob(id);
  if (job == nullptr || (job->tasks.empty() && IsFinal(job->record.phase))) {
    pb::GetJobRequest past = request;
    past.set_job(id);
    return DescribePastJob(*jobs_, past, options_.page_bytes);
  }
  pb::GetJobReply reply;
  if (request.first_task() == 0) {
    reply = OverviewOf(*job);
  } else {
    *reply.mutable_job() = SummaryOf(*job, 0.0, clock_->WallNanos());
  }
  if (request.with_tasks() || request.with_attempts()) {
    RG_RETURN_IF_ERROR(FillTasks(state_, *job, request.with_attempts(), request.first_task(),
                                 options_.page_bytes, *jobs_, &reply));
  }
  return reply;
}

Result<pb::ListWorkersReply> Server::ListWorkers(const pb::ListWorkersRequest&) {
  pb::ListWorkersReply reply;
  for (const auto& [name, worker] : state_.workers) {
    *reply.add_workers() = InfoOf(worker, state_, clock_->SteadyNanos());
  }
  return reply;
}

Result<pb::ExplainReply> Server::ExplainTask(const pb::ExplainRequest& request) {
  RG_ASSIGN_OR_RETURN(const JobId id, MeantJob(request.job()));
  const Job* job = state_.FindJob(id);
  if (job == nullptr || job->tasks.empty()) {
    pb::ExplainRequest past = request;
    past.set_job(id);
    return ExplainPastTask(*jobs_, past);
  }
  int64_t index = FindTask(*job, request.task());
  if (!request.task().empty() && index < 0) {
    return NotFoundError("job " + std::to_string(job->id) + " has no task '" + request.task() + "'");
  }
  if (request.task().empty()) {  // what would move first: ready, then uncertain, then running, then waiting
    index = 0;
    const auto rank = [&](uint32_t i) {
      switch (PhaseOf(job->tasks[i].status)) {
        case TaskPhase::kReady:
          return 0;
        case TaskPhase::kUncertain:
          return 1;
        case TaskPhase::kFailed:
          return 2;
        case TaskPhase::kLeased:
          return 3;
        case TaskPhase::kWaiting:
          return 4;
        default:
          return 5;
      }
    };
    for (uint32_t i = 1; i < job->tasks.size(); ++i) {
      if (rank(i) < rank(static_cast<uint32_t>(index))) index = i;
    }
  }
  const Explanation explanation = Explain(state_, *job, static_cast<uint32_t>(index));
  pb::ExplainReply reply;
  reply.set_task(job->plan_of(static_cast<uint32_t>(index)).name);
  reply.set_state(static_cast<pb::TaskState>(PhaseOf(job->tasks[static_cast<size_t>(index)].status)));
  for (const std::string& reason : explanation.reasons) reply.add_reasons(reason);
  reply.set_placeable(explanation.placeable);
  return reply;
}

Result<pb::StatusReply> Server::DescribeSelf(const pb::StatusRequest&) {
  pb::StatusReply reply;
  reply.set_instance(self_.id);
  reply.set_version(options_.version);
  reply.set_started_ns(started_ns_);
  reply.set_database(options_.database_path);
  reply.set_database_identity(database_->identity());
  reply.set_trouble(trouble_);
  for (const auto& [name, worker] : state_.workers) {
    if (!worker.connected) continue;
    reply.set_workers(reply.workers() + 1);
    reply.set_slots(reply.slots() + worker.slots);
    reply.set_slots_busy(reply.slots_busy() + std::min(worker.busy(), worker.slots));
  }
  uint64_t waiting = 0, ready = 0, leased = 0;
  for (const auto& [id, job] : state_.jobs) {
    if (IsFinal(job.record.phase)) continue;
    leased += job.leased;
    for (const Task& task : job.tasks) {
      const bool is_ready = std::holds_alternative<TaskReady>(task.status);
      ready += is_ready && !job.is_held();
      waiting += std::holds_alternative<TaskWaiting>(task.status) || (is_ready && job.is_held());
    }
  }
  reply.set_tasks_waiting(waiting);
  reply.set_tasks_ready(ready);
  reply.set_tasks_leased(leased);
  AddSeconds(state_, &reply);
  AddRoom(options_.database_path, &reply);
  reply.set_oldest_ready_s(OldestReadySeconds(state_, clock_->WallNanos()));
  for (const auto& [robot, hold] : state_.holds) {
    pb::RobotHold* out = reply.add_holds();
    out->set_robot(robot);
    out->set_reason(hold.reason);
    out->set_by(hold.by);
    out->set_since_ns(hold.since_ns);
  }
  AddDemand(state_, options_.policy, &reply);
  const Counters& c = state_.counters;
  const transport::SocketMetrics& m = socket_->metrics();
  const std::pair<const char*, uint64_t> counters[] = {{"jobs_submitted_total", c.jobs_submitted},
                                                       {"jobs_succeeded_total", c.jobs_succeeded},
                                                       {"jobs_failed_total", c.jobs_failed},
                                                       {"jobs_cancelled_total", c.jobs_cancelled},
                                                       {"tasks_committed_total", c.tasks_committed},
                                                       {"tasks_failed_total", c.tasks_failed},
                                                       {"attempts_started_total", c.attempts_started},
                                                       {"attempts_lost_total", c.attempts_lost},
                                                       {"results_refused_total", c.results_refused},
                                                       {"workers_lost_total", c.workers_lost},
                                                       {"executors_crashed_total", c.executors_crashed},
                                                       {"batches_total", batches_},
                                                       {"commits_total", commits_},
                                                       {"commits_failed_total", failed_commits_},
                                                       {"messages_received_total", m.received},
                                                       {"messages_sent_total", m.sent},
                                                       {"messages_dropped_total", m.dropped()},
                                                       {"messages_ignored_total", ignored_messages_},
                                                       {"log_lines_dropped_total", log_lines_dropped_},
                                                       {"stalls_total", stalls_}};
  for (const auto& [name, value] : counters) (*reply.mutable_counters())[name] = static_cast<double>(value);
  return reply;
}

// --- long polls --------------------------------------------------------------------------------------------

void Server::AnswerWatchers() {
  const int64_t steady = clock_->SteadyNanos();
  std::erase_if(watchers_, [&](const Watcher& watcher) {
    const Job* job = state_.FindJob(watcher.body.job());
    const bool is_over = job == nullptr || IsFinal(job->record.phase);
    const bool changed =
        job != nullptr && job->revision > watcher.body.after_revision() && steady >= watcher.earliest_ns;
    if (!is_over && !changed && steady < watcher.deadline_ns) return false;
    Reply(AnswerQuery(watcher.request));
    return true;
  });
}

}  // namespace rg::coordinator
