#include <algorithm>
#include <vector>

#include "coordinator/core/turn.h"

namespace rg::coordinator {
namespace {

std::string Attempts(const std::string& what, uint32_t count) {
  return what + " " + std::to_string(count) + (count == 1 ? " time" : " times");
}

}  // namespace

void Turn::Handle(const StartRequested& event) {
  Lease* lease = s_.FindLease(event.token, event.instance);
  const bool valid = lease != nullptr && [&] {
    const Job* job = s_.FindJob(JobOf(lease->task));
    return std::holds_alternative<TaskLeased>(job->tasks[IndexOf(lease->task)].status);
  }();
  if (!valid) {
    RevokeFrom(event.instance, event.token, "the lease has expired");
    return;
  }
  if (!lease->granted && s_.FindJob(JobOf(lease->task))->plan_of(IndexOf(lease->task)).at_most_once) {
    lease->granted = true;
    Store(GrantAttempt{event.token, now_.wall_ns});
  }
  Send(GrantStart{event.instance, event.token});
}

void Turn::Handle(const Progressed& event) {
  Lease* lease = s_.FindLease(event.token, event.instance);
  if (lease == nullptr) return;
  lease->progress_stage = event.stage;
  lease->progress_done = event.done;
  lease->progress_total = event.total;
  lease->progress_note = event.note;
  s_.FindJob(JobOf(lease->task))->revision = ++s_.revision;
}

void Turn::Handle(const Finished& event) {
  const Lease* lease = s_.FindLease(event.token, event.instance);
  if (lease == nullptr) {
    RefuseResult(event);
    return;
  }
  Job& job = *s_.FindJob(JobOf(lease->task));
  const uint32_t index = IndexOf(lease->task);
  const std::string instance = event.instance;
  NoteSeconds(job, index, event.seconds);
  EndLease(event.token, Outcome::kSucceeded, "");
  if (Worker* worker = s_.FindWorkerByInstance(instance)) {
    ++worker->tasks_done;
    worker->failing.erase(job.plan_of(index).kind);
    worker->suspicions = 0;
  }
  KindSeconds& kind = s_.kinds[job.plan_of(index).kind];
  ++kind.finished;
  kind.sum += std::max(0.0, event.seconds);
  for (size_t i = 0; i < kind.at_most.size(); ++i) kind.at_most[i] += event.seconds <= KindSeconds::kAtMost[i];
  CommitTask(job, index, event.token, event.remark);
  Send(AnswerResult{instance, event.token, true, ""});
}

void Turn::NoteSeconds(const Job& job, uint32_t index, double seconds) {
  if (seconds < 0.0) return;
  double& known = s_.classes[job.tasks[index].scheduling_class].seconds;
  constexpr double kFall = 0.2;
  known = seconds > known ? seconds : known + kFall * (seconds - known);
}

void Turn::CommitTask(Job& job, uint32_t index, Token token, const std::string& remark) {
  SetStatus(s_, job, index, TaskSucceeded{token});
  job.tasks[index].finished_ns = now_.wall_ns;
  job.failed_on.erase(index);
  ++s_.counters.tasks_committed;
  PersistTask(job, index, remark);
  if (!remark.empty()) SetJobPhase(job, job.record.phase, remark);
  Store(CommitResult{MakeTaskId(job.id, index), token, now_.wall_ns});
  CloseJobsOf(MakeTaskId(job.id, index));
  ReleaseChildren(job, index);
  CloseJobIfSettled(job);
}

void Turn::ReleaseChildren(Job& job, uint32_t index) {
  const Task& task = job.tasks[index];
  for (uint32_t c = task.first_child; c < task.first_child + task.child_count; ++c) {
    const uint32_t child = job.children[c].child;
    auto* waiting = std::get_if<TaskWaiting>(&job.tasks[child].status);
    if (waiting != nullptr && --waiting->parents_left == 0) Enqueue(s_, job, child);
  }
}

// The task failed for good. Children that can do without it have one parent less, the others can no
// longer run and are cancelled, and so on down. The job is lost where such a line ends at a task that
// nothing depends on.
bool Turn::CancelDescendants(Job& job, uint32_t index) {
  bool job_is_lost = false;
  std::vector<uint32_t> gone = {index};
  while (!gone.empty()) {
    const uint32_t parent = gone.back();
    gone.pop_back();
    const Task& task = job.tasks[parent];
    if (task.child_count == 0) job_is_lost = true;
    for (uint32_t c = task.first_child; c < task.first_child + task.child_count; ++c) {
      const ChildEdge edge = job.children[c];
      auto* waiting = std::get_if<TaskWaiting>(&job.tasks[edge.child].status);
      if (waiting == nullptr) continue;
      if (edge.optional) {
        if (--waiting->parents_left == 0) Enqueue(s_, job, edge.child);
        continue;
      }
      SetStatus(s_, job, edge.child, TaskCancelled{});
      PersistTask(job, edge.child, "needs " + job.plan_of(parent).name + ", which failed");
      gone.push_back(edge.child);
    }
  }
  return job_is_lost;
}

void Turn::RefuseResult(const Finished& event) {
  const std::string& instance = event.instance;
  const TaskId task_id = event.task;
  const Token token = event.token;
  if (Worker* worker = s_.FindWorkerByInstance(instance)) worker->winding_down.erase(token);
  s_.dispatch_needed = true;
  const Job* job = s_.FindJob(JobOf(task_id));
  const uint32_t index = IndexOf(task_id);
  const bool known = job != nullptr && index < job->tasks.size();
  const auto* done = known ? std::get_if<TaskSucceeded>(&job->tasks[index].status) : nullptr;
  if ((done != nullptr && done->token == token) ||
      (!known && token != 0 && event.committed == token)) {  // a repeat of what was committed
    Send(AnswerResult{instance, token, true, ""});
    return;
  }
  ++s_.counters.results_refused;
  const std::string reason = "the lease " + std::to_string(token) + " is no longer valid";
  Note("result.refused", known ? job->id : 0, known ? job->plan_of(index).name : "", instance, reason);
  Send(AnswerResult{instance, token, false, reason});
}

void Turn::Handle(const Failed& event) {
  const Lease* found = s_.FindLease(event.token, event.instance);
  if (found == nullptr) {
    if (Worker* worker = s_.FindWorkerByInstance(event.instance)) worker->winding_down.erase(event.token);
    s_.dispatch_needed = true;
    Send(AnswerResult{event.instance, event.token, false, "the lease is no longer valid"});
    return;
  }
  const Lease lease = *found;
  Job& job = *s_.FindJob(JobOf(lease.task));
  const uint32_t index = IndexOf(lease.task);
  EndLease(event.token, event.outcome, event.error);
  if (Worker* worker = s_.FindWorkerByInstance(event.instance)) worker->last_error = event.error;
  Note("task." + std::string(event.outcome == Outcome::kCrashed    ? "crashed"
                             : event.outcome == Outcome::kTimedOut ? "timed_out"
                             : event.outcome == Outcome::kLost     ? "given_back"
                                                                   : "failed"),
       job.id, job.plan_of(index).name, lease.worker, event.error);
  AfterFailure(job, index, event, lease);
  Send(AnswerResult{event.instance, event.token, true, ""});
}

// Decides between another attempt and giving up. An at-most-once task that was allowed to start gets
// no other attempt of its own accord.
void Turn::AfterFailure(Job& job, uint32_t index, const Failed& event, const Lease& lease) {
  Task& task = job.tasks[index];
  const TaskPlan& plan = job.plan_of(index);
  const bool began = plan.at_most_once && lease.granted;
  const std::string no_repeat = event.error + " (runs at most once: `retry` lets it run again)";
  if (event.outcome == Outcome::kLost || event.outcome == Outcome::kCancelled) {
    if (began) return FailTask(job, index, no_repeat, false);
    if (event.of_node) return RequeueElsewhere(job, index, lease.worker, event.error);
    constexpr double kLong = 1.0;  // it may have waited behind a task that was expected to be short
    NoteSeconds(job, index, kLong);
    return Requeue(job, index, event.error);  // given back before it did anything
  }
  if (Worker* worker = s_.FindWorkerByInstance(lease.instance)) {
    ++worker->tasks_failed;
    if (event.retryable && !began && IsOfNode(*worker, plan.kind, MakeTaskId(job.id, index), event.error))
      return RequeueElsewhere(job, index, lease.worker, event.error);
  }
  job.failed_on[index] = lease.worker;
  if (event.outcome == Outcome::kCrashed) {
    ++s_.counters.executors_crashed;
    if (++task.crashes >= plan.crash_limit) {
      FailTask(job, index, Attempts("set aside: its executor crashed", task.crashes) + ": " + event.error,
               true);
      return;
    }
  } else if (++task.failures >= plan.max_attempts || !event.retryable) {
    FailTask(job, index, event.error, false);
    return;
  }
  if (began) return FailTask(job, index, no_repeat, false);
  Requeue(job, index, event.error);
}

void Turn::RequeueElsewhere(Job& job, uint32_t index, const std::string& worker, const std::string& error) {
  job.failed_on[index] = worker;
  const uint32_t losses = ++job.tasks[index].losses;
  if (losses < s_.options.max_losses) return Requeue(job, index, error);
  FailTask(job, index, Attempts("set aside: its worker could not run it", losses) + ": " + error, true);
}

void Turn::Requeue(Job& job, uint32_t index, const std::string& reason) {
  Enqueue(s_, job, index);
  PersistTask(job, index, reason);
}

void Turn::FailTask(Job& job, uint32_t index, const std::string& reason, bool set_aside) {
  SetStatus(s_, job, index, TaskFailed{set_aside});
  job.tasks[index].finished_ns = now_.wall_ns;
  ++s_.counters.tasks_failed;
  PersistTask(job, index, reason);
  CloseJobsOf(MakeTaskId(job.id, index));
  if (CancelDescendants(job, index)) {
    CloseJob(job, JobPhase::kFailed, "task " + job.plan_of(index).name + ": " + reason);
  } else {
    CloseJobIfSettled(job);
  }
}

void Turn::PersistTask(const Job& job, uint32_t index, const std::string& reason) {
  Store(UpdateTask{MakeTaskId(job.id, index), RecordOf(job, index), reason, now_.wall_ns});
}

void Turn::EndLease(Token token, Outcome outcome, const std::string& error) {
  const auto lease = s_.leases.find(token);
  if (Worker* worker = s_.FindWorkerByInstance(lease->second.instance)) worker->leases.erase(token);
  s_.leases.erase(lease);
  s_.dispatch_needed = true;
  Store(FinishAttempt{token, outcome, error, now_.wall_ns});
}

void Turn::LoseLease(Token token, const std::string& why) {
  Lease& lease = s_.leases.at(token);
  Job& job = *s_.FindJob(JobOf(lease.task));
  const uint32_t index = IndexOf(lease.task);
  const TaskPlan& plan = job.plan_of(index);
  if (std::holds_alternative<TaskUncertain>(job.tasks[index].status)) return;
  ++s_.counters.attempts_lost;
  Note("task.lost", job.id, plan.name, lease.worker, why);
  if (plan.at_most_once && lease.granted) {
    if (Worker* worker = s_.FindWorkerByInstance(lease.instance)) worker->leases.erase(token);
    lease.deadline_ns = now_.steady_ns + s_.options.uncertain_ns;
    lease.restored = false;
    SetStatus(s_, job, index, TaskUncertain{token});
    PersistTask(job, index, "may have run on " + lease.worker + ": " + why);
    return;
  }
  EndLease(token, Outcome::kLost, why);
  if (++job.tasks[index].losses >= s_.options.max_losses) {
    FailTask(job, index, Attempts("set aside: its worker was lost", job.tasks[index].losses) + ": " + why,
             true);
    return;
  }
  Requeue(job, index, why);
}

}  // namespace rg::coordinator
