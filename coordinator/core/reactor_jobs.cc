#include <cstdio>
#include <set>
#include <vector>

#include "coordinator/core/turn.h"

namespace rg::coordinator {
namespace {

std::string PhaseName(JobPhase phase) {
  switch (phase) {
    case JobPhase::kQueued:
      return "queued";
    case JobPhase::kRunning:
      return "running";
    case JobPhase::kPaused:
      return "paused";
    case JobPhase::kSucceeded:
      return "succeeded";
    case JobPhase::kFailed:
      return "failed";
    case JobPhase::kCancelled:
      return "cancelled";
  }
  return "?";
}

std::string AlreadyIs(const Job& job) {
  return "job " + std::to_string(job.id) + " is " + PhaseName(job.record.phase);
}

}  // namespace

void Turn::Handle(const Submit& event) {
  const auto in_memory = s_.job_by_request.find(event.request_id);
  const JobId known = in_memory != s_.job_by_request.end() ? in_memory->second : event.known;
  if (known != 0) {
    const Job* job = s_.FindJob(known);
    const std::string& content = job != nullptr ? job->plan->content : event.known_content;
    if (!event.content.empty() && !content.empty() && event.content != content) {
      Send(AnswerClient{event.reply_to, Verdict::kFailedPrecondition,
                        "this request id was used for job " + std::to_string(known) +
                            ", which asked for something else: choose another id",
                        known, false});
      return;
    }
    Send(AnswerClient{event.reply_to, Verdict::kOk, "", known, true});
    return;
  }
  if (event.lease != 0 && !s_.Holds(event.plan->parent, event.lease)) {
    Send(AnswerClient{event.reply_to, Verdict::kFailedPrecondition,
                      "the lease " + std::to_string(event.lease) + " is no longer valid", 0, false});
    return;
  }
  if (const JobId unmet = UnmetOf(*event.plan, event.unmet); unmet != 0) {
    Send(AnswerClient{event.reply_to, Verdict::kFailedPrecondition,
                      "job " + std::to_string(unmet) + " did not succeed: nothing can come after it", 0, false});
    return;
  }
  Job& job = s_.jobs[++s_.last_job];
  job.id = s_.last_job;
  job.request_id = event.request_id;
  job.plan = event.plan;
  job.record.submitted_ns = now_.wall_ns;
  IndexJob(s_, job);
  AwaitJobs(s_, job);
  s_.job_by_request.emplace(event.request_id, job.id);
  if (event.plan->parent == 0) s_.newest_of_clients = job.id;
  ++s_.counters.jobs_submitted;
  Store(InsertJob{job.id, event.request_id, now_.wall_ns, event.plan, event.specs});
  Note("job.submitted", job.id, "", "", event.plan->submitted_by);
  for (uint32_t i = 0; i < job.tasks.size(); ++i) {
    if (event.plan->tasks[i].parents.empty()) Enqueue(s_, job, i);
  }
  Send(AnswerClient{event.reply_to, Verdict::kOk, "", job.id, false});
}

// A job that `plan` comes after and that is over without success; 0: none. Of those not in memory the shell
// has said so.
JobId Turn::UnmetOf(const JobPlan& plan, JobId not_in_memory) const {
  for (const JobId id : plan.after_jobs) {
    const Job* before = s_.FindJob(id);
    const bool is_over = before != nullptr && IsFinal(before->record.phase);
    if (is_over && before->record.phase != JobPhase::kSucceeded) return id;
  }
  return not_in_memory;
}

void Turn::Handle(const CommandJob& event) {
  by_ = event.by;
  Job* job = s_.FindJob(event.job);
  if (job == nullptr) {
    const std::string error = "there is no job " + std::to_string(event.job);
    Send(AnswerClient{event.reply_to, Verdict::kNotFound, error, event.job, false});
    return;
  }
  std::string error;
  Verdict verdict = Verdict::kOk;
  switch (event.command) {
    case JobCommand::kCancel:
      verdict = Cancel(*job, event.reason, &error);
      break;
    case JobCommand::kPause:
      verdict = Pause(*job, &error);
      break;
    case JobCommand::kResume:
      verdict = Resume(*job, &error);
      break;
    case JobCommand::kRetry:
      verdict = Retry(*job, event.unmet, &error);
      break;
    case JobCommand::kPriority:
      if (IsFinal(job->record.phase)) {
        error = AlreadyIs(*job) + ": its priority no longer matters";
        verdict = Verdict::kFailedPrecondition;
      } else {
        SetPriority(*job, event.priority);
      }
      break;
  }
  Send(AnswerClient{event.reply_to, verdict, error, event.job, false});
}

Verdict Turn::Cancel(Job& job, const std::string& reason, std::string* error) {
  if (job.record.phase == JobPhase::kCancelled) return Verdict::kOk;
  if (IsFinal(job.record.phase)) {
    *error = AlreadyIs(job) + ": nothing to cancel";
    return Verdict::kFailedPrecondition;
  }
  CloseJob(job, JobPhase::kCancelled, reason.empty() ? "cancelled" : reason);
  return Verdict::kOk;
}

Verdict Turn::Pause(Job& job, std::string* error) {
  if (job.record.phase == JobPhase::kPaused) return Verdict::kOk;
  if (IsFinal(job.record.phase)) {
    *error = AlreadyIs(job) + ": nothing to pause";
    return Verdict::kFailedPrecondition;
  }
  DequeueAll(s_, job);
  SetJobPhase(job, JobPhase::kPaused, job.record.reason);
  Note("job.paused", job.id, "", "", "");
  return Verdict::kOk;
}

Verdict Turn::Resume(Job& job, std::string* error) {
  if (job.record.phase == JobPhase::kQueued || job.record.phase == JobPhase::kRunning) return Verdict::kOk;
  if (job.record.phase != JobPhase::kPaused) {
    *error = AlreadyIs(job) + ": only a paused job can be resumed";
    return Verdict::kFailedPrecondition;
  }
  SetJobPhase(job, job.record.started_ns > 0 ? JobPhase::kRunning : JobPhase::kQueued, job.record.reason);
  EnqueueAll(job);
  Note("job.resumed", job.id, "", "", "");
  return Verdict::kOk;
}

// A failed job starts again where it failed. In a running one it is the consent that tasks which may
// have run already are run again.
Verdict Turn::Retry(Job& job, JobId unmet, std::string* error) {
  if (!IsFinal(job.record.phase) && job.uncertain > 0) {
    ConsentToUncertain(job);
    return Verdict::kOk;
  }
  if (job.record.phase != JobPhase::kFailed) {
    *error = AlreadyIs(job) + ": only a failed job can be retried";
    return Verdict::kFailedPrecondition;
  }
  if (job.plan->parent != 0 && s_.IsSettled(job.plan->parent)) {
    *error = AlreadyIs(job) + ", and the task of job " + std::to_string(JobOf(job.plan->parent)) +
             " that submitted it is over";
    return Verdict::kFailedPrecondition;
  }
  unmet = UnmetOf(*job.plan, unmet);
  if (unmet != 0) {
    *error = "job " + std::to_string(unmet) + ", which job " + std::to_string(job.id) +
             " comes after, did not succeed: retry that one first";
    return Verdict::kFailedPrecondition;
  }
  std::vector<uint32_t> reopened;
  for (uint32_t i = 0; i < job.tasks.size(); ++i) {
    if (std::holds_alternative<TaskSucceeded>(job.tasks[i].status)) continue;
    Task& task = job.tasks[i];
    task.failures = task.crashes = task.losses = 0;
    SetStatus(s_, job, i, TaskWaiting{});
    reopened.push_back(i);
  }
  job.record.finished_ns = 0;
  AwaitJobs(s_, job);
  if (job.record.started_ns > 0) StartTheClock(job);
  SetJobPhase(job, job.record.started_ns > 0 ? JobPhase::kRunning : JobPhase::kQueued, "");
  Store(ReopenTasks{job.id});
  Note("job.retried", job.id, "", "", std::to_string(reopened.size()) + " tasks again");
  for (const uint32_t i : reopened) {
    const uint32_t open = CountOpenParents(job, i);
    job.tasks[i].status = TaskWaiting{open};
  }
  for (const uint32_t i : reopened) {
    if (std::get<TaskWaiting>(job.tasks[i].status).parents_left == 0) Enqueue(s_, job, i);
  }
  return Verdict::kOk;
}

void Turn::ConsentToUncertain(Job& job) {
  for (uint32_t i = 0; i < job.tasks.size(); ++i) {
    const auto* uncertain = std::get_if<TaskUncertain>(&job.tasks[i].status);
    if (uncertain == nullptr) continue;
    const Token token = uncertain->token;
    RevokeFrom(s_.leases.at(token).instance, token, "another attempt was allowed");
    EndLease(token, Outcome::kLost, "lost; another attempt was allowed");
    Enqueue(s_, job, i);
    PersistTask(job, i, "run again with consent");
    Note("task.consent", job.id, job.plan_of(i).name, "", "an at-most-once task may run again");
  }
}

void Turn::CloseJob(Job& job, JobPhase phase, const std::string& reason) {
  std::vector<Token> open;
  for (uint32_t i = 0; i < job.tasks.size(); ++i) {
    const TaskStatus& status = job.tasks[i].status;
    const TaskPhase task_phase = PhaseOf(status);
    if (task_phase == TaskPhase::kSucceeded || task_phase == TaskPhase::kFailed ||
        task_phase == TaskPhase::kCancelled) {
      continue;
    }
    if (task_phase == TaskPhase::kReady) Dequeue(s_, job, i);
    if (const auto* leased = std::get_if<TaskLeased>(&status)) open.push_back(leased->token);
    if (const auto* uncertain = std::get_if<TaskUncertain>(&status)) open.push_back(uncertain->token);
    SetStatus(s_, job, i, TaskCancelled{});
  }
  for (const Token token : open) {
    RevokeFrom(s_.leases.at(token).instance, token, reason);
    EndLease(token, Outcome::kCancelled, reason);
  }
  StopAwaiting(s_, job);
  Store(CloseTasks{job.id, reason, now_.wall_ns});
  job.record.finished_ns = now_.wall_ns;
  SetJobPhase(job, phase, reason);
  s_.ended.push_back(job.id);
  (phase == JobPhase::kCancelled ? s_.counters.jobs_cancelled : s_.counters.jobs_failed)++;
  Note(phase == JobPhase::kCancelled ? "job.cancelled" : "job.failed", job.id, "", "", reason);
  for (uint32_t i = 0; i < job.tasks.size(); ++i) CloseJobsOf(MakeTaskId(job.id, i));
  TellJobsAfter(job);
}

void Turn::CloseJobsOf(TaskId task) {
  const auto found = s_.jobs_of_task.find(task);
  if (found == s_.jobs_of_task.end()) return;
  for (const JobId id : found->second) {
    Job* job = s_.FindJob(id);
    if (job != nullptr && !IsFinal(job->record.phase))
      CloseJob(*job, JobPhase::kCancelled, "the task that submitted it is over");
  }
}

void Turn::CloseJobIfSettled(Job& job) {
  if (IsFinal(job.record.phase) || job.settled() < job.tasks.size()) return;
  job.record.finished_ns = now_.wall_ns;
  SetJobPhase(job, JobPhase::kSucceeded, job.record.reason);
  s_.ended.push_back(job.id);
  ++s_.counters.jobs_succeeded;
  Note("job.succeeded", job.id, "", "", job.record.reason);
  TellJobsAfter(job);
}

// A long line of jobs that each come after the one before ends here, not in a stack as deep.
void Turn::TellJobsAfter(Job& ended) {
  ended_.push_back(ended.id);
  if (ended_.size() > 1) return;  // whoever empties the list is further up
  for (; !ended_.empty(); ended_.pop_front()) {
    const Job& before = *s_.FindJob(ended_.front());
    const auto waiting = s_.jobs_waiting_for.find(before.id);
    if (waiting == s_.jobs_waiting_for.end()) continue;
    const std::set<JobId> after = waiting->second;
    for (const JobId id : after) {
      Job& job = *s_.FindJob(id);
      if (before.record.phase != JobPhase::kSucceeded) {
        CloseJob(job, JobPhase::kFailed, AlreadyIs(before) + ", and this one comes after it");
        continue;
      }
      waiting->second.erase(id);
      job.waits_for.erase(before.id);
      job.revision = ++s_.revision;
      if (job.waits_for.empty()) EnqueueAll(job);
    }
    s_.jobs_waiting_for.erase(before.id);
  }
}

void Turn::EnqueueAll(Job& job) {
  for (uint32_t i = 0; i < job.tasks.size(); ++i) {
    if (std::holds_alternative<TaskReady>(job.tasks[i].status)) Enqueue(s_, job, i);
  }
}

void Turn::SetPriority(Job& job, int32_t priority) {
  const int32_t by = priority - (job.plan->priority + job.record.priority_shift);
  if (by == 0) return;
  std::vector<JobId> family = {job.id};
  for (size_t k = 0; k < family.size(); ++k) {
    const TaskId first = MakeTaskId(family[k], 0), last = MakeTaskId(family[k], kMaxTasksPerJob - 1);
    for (auto of = s_.jobs_of_task.lower_bound(first); of != s_.jobs_of_task.end() && of->first <= last; ++of)
      family.insert(family.end(), of->second.begin(), of->second.end());
    Job& one = *s_.FindJob(family[k]);
    if (!IsFinal(one.record.phase)) ShiftPriority(one, by);
  }
}

void Turn::ShiftPriority(Job& job, int32_t by) {
  DequeueAll(s_, job);
  job.record.priority_shift += by;
  EnqueueAll(job);
  SetJobPhase(job, job.record.phase, job.record.reason);
  Note("job.priority", job.id, "", "", std::to_string(job.plan->priority + job.record.priority_shift));
}

void Turn::StartTheClock(Job& job) {
  job.is_overdue = false;
  if (job.plan->time_limit_ns == 0) return;
  job.deadline_ns = now_.steady_ns + job.plan->time_limit_ns;
  job.record.deadline_ns = now_.wall_ns + job.plan->time_limit_ns;
}

// A limit ends what still runs. What was finished before it, or while nobody was here to take it, counts however
// long its way takes: the job goes on without anything new until all who hold something of it have spoken.
void Turn::EndOverdueJobs() {
  std::vector<JobId> overdue;
  for (auto& [id, job] : s_.jobs) {
    if (IsFinal(job.record.phase) || job.deadline_ns == 0) continue;
    if (!job.is_overdue && job.deadline_ns >= now_.steady_ns) continue;
    HoldOverdue(s_, job);
    overdue.push_back(id);
  }
  if (overdue.empty()) return;
  std::set<JobId> may_yet_count;
  for (const auto& [token, lease] : s_.leases) {
    const Job& job = *s_.FindJob(JobOf(lease.task));
    if (job.is_overdue && MayYetCount(job, lease)) may_yet_count.insert(job.id);
  }
  for (const JobId id : overdue) {
    Job& job = *s_.FindJob(id);
    if (may_yet_count.count(id) > 0 || IsFinal(job.record.phase)) continue;  // or it went with one before
    char limit[32];
    std::snprintf(limit, sizeof limit, "%g", 1e-9 * static_cast<double>(job.plan->time_limit_ns));
    CloseJob(job, JobPhase::kFailed, "its time limit of " + std::string(limit) + " s is over");
  }
}

// Whether the task may have been finished in time: its worker says that it no longer runs, or has not named it
// since. A heartbeat that comes within an interval of the limit may have been on its way before.
bool Turn::MayYetCount(const Job& job, const Lease& lease) const {
  return lease.finished || lease.named_ns < job.deadline_ns + s_.options.heartbeat_ns;
}

void Turn::SetJobPhase(Job& job, JobPhase phase, const std::string& reason) {
  job.record.phase = phase;
  job.record.reason = reason;
  job.revision = ++s_.revision;
  Store(UpdateJob{job.id, job.record, CountsOf(job)});
}

}  // namespace rg::coordinator
