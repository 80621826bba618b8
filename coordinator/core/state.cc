#include "coordinator/core/state.h"

#include <algorithm>
#include <utility>

#include "common/base/check.h"

namespace rg::coordinator {
namespace {

template <class... F>
struct Overloaded : F... {
  using F::operator()...;
};
template <class... F>
Overloaded(F...) -> Overloaded<F...>;

uint32_t InternClass(State& state, const TaskPlan& plan) {
  std::vector<std::string> tags = plan.required_tags;
  std::sort(tags.begin(), tags.end());
  auto key = std::make_pair(plan.kind, std::move(tags));
  const auto found = state.class_index.find(key);
  if (found != state.class_index.end()) return found->second;
  auto id = static_cast<uint32_t>(state.classes.size());
  if (state.free_classes.empty()) {
    state.classes.emplace_back();
  } else {
    id = state.free_classes.back();
    state.free_classes.pop_back();
  }
  state.classes[id] = {key.first, key.second, {}};
  for (auto& [name, worker] : state.workers) {
    if (CanRun(worker, state.classes[id])) worker.classes.push_back(id);
  }
  state.class_index.emplace(std::move(key), id);
  return id;
}

// Kinds and tags that nobody uses any more must not pile up.
void LeaveClass(State& state, uint32_t id) {
  SchedulingClass& cls = state.classes[id];
  if (--cls.tasks > 0) return;
  state.class_index.erase({cls.kind, cls.tags});
  cls = {};
  state.free_classes.push_back(id);
  for (auto& [name, worker] : state.workers) std::erase(worker.classes, id);
}

void IndexChildren(Job& job) {
  const auto& plans = job.plan->tasks;
  for (const TaskPlan& plan : plans) {
    for (const ParentEdge& edge : plan.parents) ++job.tasks[edge.parent].child_count;
  }
  uint32_t next = 0;
  for (Task& task : job.tasks) {
    task.first_child = next;
    next += task.child_count;
    task.child_count = 0;
  }
  job.children.resize(next);
  for (uint32_t i = 0; i < plans.size(); ++i) {
    for (const ParentEdge& edge : plans[i].parents) {
      Task& parent = job.tasks[edge.parent];
      job.children[parent.first_child + parent.child_count++] = {i, edge.optional};
    }
  }
}

// Adds `sign` to the counts that a task in this status is part of.
void Count(Job& job, uint32_t index, int sign) {
  const double weight = job.plan_of(index).weight;
  std::visit(
      Overloaded{[](const TaskWaiting&) {}, [](const TaskReady&) {},
                 [&](const TaskLeased&) { job.leased += sign; },
                 [&](const TaskSucceeded&) { job.succeeded += sign, job.weight_done += sign * weight; },
                 [&](const TaskFailed&) { job.failed += sign; },
                 [&](const TaskCancelled&) { job.cancelled += sign; },
                 [&](const TaskUncertain&) { job.uncertain += sign; }},
      job.tasks[index].status);
}

bool IsOpenFor(const TaskStatus& parent, bool optional) {
  switch (PhaseOf(parent)) {
    case TaskPhase::kSucceeded:
      return false;
    case TaskPhase::kFailed:
    case TaskPhase::kCancelled:
      return !optional;
    default:
      return true;
  }
}

TaskStatus StatusOf(const TaskRecord& record) {
  switch (record.phase) {
    case TaskPhase::kWaiting:
    case TaskPhase::kReady:
      return TaskWaiting{};
    case TaskPhase::kLeased:
      return TaskLeased{record.token};
    case TaskPhase::kSucceeded:
      return TaskSucceeded{record.token};
    case TaskPhase::kFailed:
      return TaskFailed{record.set_aside};
    case TaskPhase::kCancelled:
      return TaskCancelled{};
    case TaskPhase::kUncertain:
      return TaskUncertain{record.token};
  }
  return TaskWaiting{};
}

void RestoreTask(State& state, Job& job, uint32_t index, const TaskRecord& record) {
  Task& task = job.tasks[index];
  task.attempts = record.attempts;
  task.failures = record.failures;
  task.crashes = record.crashes;
  task.losses = record.losses;
  task.started_ns = record.started_ns;
  task.finished_ns = record.finished_ns;
  SetStatus(state, job, index, StatusOf(record));
}

// Waiting tasks get their count of open parents; those without any are ready.
void RestoreReadiness(State& state, Job& job) {
  for (uint32_t i = 0; i < job.tasks.size(); ++i) {
    if (!std::holds_alternative<TaskWaiting>(job.tasks[i].status)) continue;
    const uint32_t open = CountOpenParents(job, i);
    if (open > 0 || IsFinal(job.record.phase)) {
      job.tasks[i].status = TaskWaiting{open};
    } else {
      Enqueue(state, job, i);
    }
  }
}

void RestoreLease(State& state, const OpenAttempt& attempt, Now now) {
  Job* job = state.FindJob(JobOf(attempt.task));
  if (job == nullptr || IndexOf(attempt.task) >= job->tasks.size()) return;
  const TaskStatus& status = job->tasks[IndexOf(attempt.task)].status;
  Lease lease;
  lease.task = attempt.task;
  lease.attempt = attempt.number;
  lease.worker = attempt.worker;
  lease.instance = attempt.instance;
  lease.key = attempt.key;
  lease.granted = attempt.granted;
  lease.restored = true;
  const bool uncertain = std::holds_alternative<TaskUncertain>(status);
  lease.deadline_ns =
      now.steady_ns + (uncertain ? state.options.uncertain_ns : state.options.restart_grace_ns());
  state.leases.emplace(attempt.token, std::move(lease));
}

bool Same(const TaskRecord& a, const TaskRecord& b) {
  return a.phase == b.phase && a.attempts == b.attempts && a.failures == b.failures &&
         a.crashes == b.crashes && a.losses == b.losses && a.token == b.token && a.set_aside == b.set_aside;
}

}  // namespace

TaskPhase PhaseOf(const TaskStatus& status) {
  return std::visit(Overloaded{[](const TaskWaiting&) { return TaskPhase::kWaiting; },
                               [](const TaskReady&) { return TaskPhase::kReady; },
                               [](const TaskLeased&) { return TaskPhase::kLeased; },
                               [](const TaskSucceeded&) { return TaskPhase::kSucceeded; },
                               [](const TaskFailed&) { return TaskPhase::kFailed; },
                               [](const TaskCancelled&) { return TaskPhase::kCancelled; },
                               [](const TaskUncertain&) { return TaskPhase::kUncertain; }},
                    status);
}

Job* State::FindJob(JobId id) {
  const auto found = jobs.find(id);
  return found == jobs.end() ? nullptr : &found->second;
}

const Job* State::FindJob(JobId id) const {
  const auto found = jobs.find(id);
  return found == jobs.end() ? nullptr : &found->second;
}

Worker* State::FindWorkerByInstance(const std::string& instance) {
  const auto name = worker_by_instance.find(instance);
  if (name == worker_by_instance.end()) return nullptr;
  const auto worker = workers.find(name->second);
  return worker == workers.end() ? nullptr : &worker->second;
}

Lease* State::FindLease(Token token, const std::string& instance) {
  const auto found = leases.find(token);
  if (found == leases.end() || found->second.instance != instance) return nullptr;
  return &found->second;
}

bool State::IsSettled(TaskId task) const {
  const Job* job = FindJob(JobOf(task));
  if (job == nullptr || IsFinal(job->record.phase)) return true;  // over, with everything of it
  const TaskPhase phase = PhaseOf(job->tasks.at(IndexOf(task)).status);
  return phase == TaskPhase::kSucceeded || phase == TaskPhase::kFailed || phase == TaskPhase::kCancelled;
}

bool State::Holds(TaskId task, Token token) const {
  const Job* job = FindJob(JobOf(task));
  if (job == nullptr || IndexOf(task) >= job->tasks.size()) return false;
  const auto* leased = std::get_if<TaskLeased>(&job->tasks[IndexOf(task)].status);
  return leased != nullptr && leased->token == token;
}

// A class that is free has no kind, whatever a worker says it runs.
bool CanRun(const Worker& worker, const SchedulingClass& cls) {
  return !cls.kind.empty() && worker.kinds.count(cls.kind) > 0 &&
         std::all_of(cls.tags.begin(), cls.tags.end(),
                     [&](const std::string& tag) { return worker.tags.count(tag) > 0; });
}

void IndexJob(State& state, Job& job) {
  const auto& plans = job.plan->tasks;
  job.tasks.assign(plans.size(), Task{});
  std::map<std::string, uint32_t> stage_index;
  for (uint32_t i = 0; i < plans.size(); ++i) {
    const auto [stage, is_new] =
        stage_index.emplace(plans[i].stage, static_cast<uint32_t>(job.stages.size()));
    if (is_new) job.stages.push_back(plans[i].stage);
    job.tasks[i].stage = stage->second;
    job.tasks[i].scheduling_class = InternClass(state, plans[i]);
    ++state.classes[job.tasks[i].scheduling_class].tasks;
    job.tasks[i].status = TaskWaiting{static_cast<uint32_t>(plans[i].parents.size())};
    job.weight_total += plans[i].weight;
  }
  if (job.plan->parent != 0) state.jobs_of_task[job.plan->parent].push_back(job.id);
  IndexChildren(job);
}

void AwaitJobs(State& state, Job& job) {
  for (const JobId id : job.plan->after_jobs) {
    const Job* before = state.FindJob(id);
    if (before == nullptr || IsFinal(before->record.phase)) continue;
    job.waits_for.insert(id);
    state.jobs_waiting_for[id].insert(job.id);
  }
}

void StopAwaiting(State& state, Job& job) {
  for (const JobId id : std::exchange(job.waits_for, {})) {
    const auto waiting = state.jobs_waiting_for.find(id);
    waiting->second.erase(job.id);
    if (waiting->second.empty()) state.jobs_waiting_for.erase(waiting);
  }
}

void Enqueue(State& state, Job& job, uint32_t index) {
  SetStatus(state, job, index, TaskReady{});
  if (job.is_held()) return;
  const int32_t priority = job.priority_of(index);
  state.classes[job.tasks[index].scheduling_class].ready.insert({priority, MakeTaskId(job.id, index)});
  state.dispatch_needed = true;
}

void Dequeue(State& state, Job& job, uint32_t index) {
  const int32_t priority = job.priority_of(index);
  state.classes[job.tasks[index].scheduling_class].ready.erase({priority, MakeTaskId(job.id, index)});
}

void DequeueAll(State& state, Job& job) {
  for (uint32_t i = 0; i < job.tasks.size(); ++i) {
    if (std::holds_alternative<TaskReady>(job.tasks[i].status)) Dequeue(state, job, i);
  }
}

void HoldOverdue(State& state, Job& job) {
  if (job.is_overdue) return;
  DequeueAll(state, job);
  job.is_overdue = true;
  job.revision = ++state.revision;
}

void SetStatus(State& state, Job& job, uint32_t index, TaskStatus status) {
  Count(job, index, -1);
  job.tasks[index].status = status;
  Count(job, index, +1);
  job.revision = ++state.revision;
}

uint32_t CountOpenParents(const Job& job, uint32_t index) {
  uint32_t open = 0;
  for (const ParentEdge& edge : job.plan_of(index).parents) {
    open += IsOpenFor(job.tasks[edge.parent].status, edge.optional) ? 1 : 0;
  }
  return open;
}

TaskRecord RecordOf(const Job& job, uint32_t index) {
  const Task& task = job.tasks[index];
  TaskRecord record;
  record.phase = PhaseOf(task.status);
  record.attempts = task.attempts;
  record.failures = task.failures;
  record.crashes = task.crashes;
  record.losses = task.losses;
  if (const auto* leased = std::get_if<TaskLeased>(&task.status)) record.token = leased->token;
  if (const auto* uncertain = std::get_if<TaskUncertain>(&task.status)) record.token = uncertain->token;
  if (const auto* succeeded = std::get_if<TaskSucceeded>(&task.status)) record.token = succeeded->token;
  if (const auto* failed = std::get_if<TaskFailed>(&task.status)) record.set_aside = failed->set_aside;
  return record;
}

JobCounts CountsOf(const Job& job) {
  if (job.record.phase == JobPhase::kSucceeded) return {job.succeeded, job.failed + job.uncertain, 1.0};
  const double total = std::max(job.weight_total, 1e-12);
  return {job.succeeded, job.failed + job.uncertain, std::clamp(job.weight_done / total, 0.0, 1.0)};
}

void Retire(State& state, JobId id) {
  const auto found = state.jobs.find(id);
  if (found == state.jobs.end() || !IsFinal(found->second.record.phase)) return;
  const Job& job = found->second;
  if (const auto known = state.job_by_request.find(job.request_id);
      known != state.job_by_request.end() && known->second == id)
    state.job_by_request.erase(known);
  const TaskId first = MakeTaskId(id, 0), last = MakeTaskId(id, kMaxTasksPerJob - 1);
  state.jobs_of_task.erase(state.jobs_of_task.lower_bound(first), state.jobs_of_task.upper_bound(last));
  if (const auto siblings = state.jobs_of_task.find(job.plan->parent); siblings != state.jobs_of_task.end()) {
    std::erase(siblings->second, id);
    if (siblings->second.empty()) state.jobs_of_task.erase(siblings);
  }
  for (const Task& task : job.tasks) LeaveClass(state, task.scheduling_class);
  state.jobs.erase(found);
}

Job& Recall(State& state, const StoredJob& stored) {
  Job& job = state.jobs[stored.job];
  job.id = stored.job;
  job.request_id = stored.request_id;
  job.plan = stored.plan;
  job.record = stored.record;
  job.revision = ++state.revision;
  IndexJob(state, job);
  if (!IsFinal(job.record.phase)) AwaitJobs(state, job);
  for (uint32_t i = 0; i < job.tasks.size(); ++i) RestoreTask(state, job, i, stored.tasks[i]);
  RestoreReadiness(state, job);
  state.job_by_request.emplace(stored.request_id, stored.job);
  return job;
}

State Restore(const StoredState& stored, const Options& options, Now now) {
  State state;
  state.options = options;
  state.last_token = stored.last_token;
  state.last_job = stored.last_job;
  state.newest_of_clients = stored.newest_of_clients;
  state.holds = stored.holds;
  for (const StoredJob& from : stored.jobs) {
    Job& job = Recall(state, from);
    if (job.record.deadline_ns == 0) continue;
    // The clock on the wall may have been set meanwhile: never more than the whole limit is left.
    const int64_t left = job.record.deadline_ns - now.wall_ns;
    job.deadline_ns = now.steady_ns + std::clamp<int64_t>(left, 0, job.plan->time_limit_ns);
    if (left <= 0) HoldOverdue(state, job);
  }
  for (const OpenAttempt& attempt : stored.open_attempts) RestoreLease(state, attempt, now);
  state.dispatch_needed = false;  // nobody is there yet
  return state;
}

void MarkHeld(const State& state, Worker& worker) {
  worker.held.clear();
  for (const std::string& tag : worker.tags) {
    const bool is_robot = tag.rfind(kRobotTag, 0) == 0;
    const auto hold = is_robot ? state.holds.find(tag.substr(sizeof kRobotTag - 1)) : state.holds.end();
    if (hold == state.holds.end()) continue;
    worker.held = "is held" + (hold->second.by.empty() ? "" : " by " + hold->second.by) +
                  (hold->second.reason.empty() ? "" : ": " + hold->second.reason);
  }
}

void KeepWorkers(const State& before, State& after, Now now) {
  after.counters = before.counters;
  after.revision += before.revision;
  after.kinds = before.kinds;
  after.workers = before.workers;
  after.worker_by_instance = before.worker_by_instance;
  for (auto& [name, worker] : after.workers) {
    worker.leases.clear();
    MarkHeld(after, worker);
    worker.classes.clear();
    for (uint32_t c = 0; c < after.classes.size(); ++c) {
      if (CanRun(worker, after.classes[c])) worker.classes.push_back(c);
    }
  }
  for (auto& [token, lease] : after.leases) {
    Worker* worker = after.FindWorkerByInstance(lease.instance);
    const Job& job = after.jobs.at(JobOf(lease.task));
    const bool runs = std::holds_alternative<TaskLeased>(job.tasks[IndexOf(lease.task)].status);
    if (worker == nullptr || !worker->connected || !runs) continue;
    worker->winding_down.erase(token);  // it was revoked in the batch that came to nothing
    worker->leases.insert(token);
    lease.restored = false;
    lease.deadline_ns = now.steady_ns + after.options.restart_grace_ns();
    if (const auto old = before.leases.find(token); old != before.leases.end()) {
      lease.progress_stage = old->second.progress_stage;
      lease.progress_done = old->second.progress_done;
      lease.progress_total = old->second.progress_total;
      lease.progress_note = old->second.progress_note;
    }
  }
  for (auto& [name, worker] : after.workers) {
    std::erase_if(worker.winding_down, [&](Token token) { return token > after.last_token; });
  }
}

StoredState Describe(const State& state) {
  StoredState out;
  out.last_token = state.last_token;
  out.last_job = state.last_job;
  out.newest_of_clients = state.newest_of_clients;
  out.holds = state.holds;
  for (const auto& [id, job] : state.jobs) {
    if (IsFinal(job.record.phase)) continue;  // about to leave
    StoredJob& to = out.jobs.emplace_back();
    to.job = id;
    to.request_id = job.request_id;
    to.record = job.record;
    to.plan = job.plan;
    for (uint32_t i = 0; i < job.tasks.size(); ++i) to.tasks.push_back(RecordOf(job, i));
  }
  for (const auto& [token, lease] : state.leases) {
    out.open_attempts.push_back(
        {lease.task, token, lease.attempt, lease.worker, lease.instance, lease.key, lease.granted});
  }
  std::sort(out.open_attempts.begin(), out.open_attempts.end(),
            [](const OpenAttempt& a, const OpenAttempt& b) { return a.token < b.token; });
  return out;
}

std::vector<std::string> Differences(const StoredState& a, const StoredState& b) {
  std::vector<std::string> found;
  if (a.last_token != b.last_token) found.push_back("last token");
  if (a.last_job != b.last_job) found.push_back("last job");
  if (a.newest_of_clients != b.newest_of_clients) found.push_back("newest job of clients");
  const auto same_hold = [](const auto& x, const auto& y) {
    return x.first == y.first && x.second.reason == y.second.reason && x.second.by == y.second.by;
  };
  if (!std::equal(a.holds.begin(), a.holds.end(), b.holds.begin(), b.holds.end(), same_hold))
    found.push_back("robots that are held");
  if (a.jobs.size() != b.jobs.size()) return found.push_back("number of jobs"), found;
  for (size_t j = 0; j < a.jobs.size(); ++j) {
    const StoredJob &x = a.jobs[j], &y = b.jobs[j];
    const std::string where = "job " + std::to_string(x.job);
    if (x.job != y.job || x.request_id != y.request_id || x.plan->parent != y.plan->parent ||
        x.plan->content != y.plan->content)
      found.push_back(where + ": identity");
    if (x.record.phase != y.record.phase || x.record.reason != y.record.reason)
      found.push_back(where + ": phase");
    if (x.record.priority_shift != y.record.priority_shift) found.push_back(where + ": priority");
    if (x.record.deadline_ns != y.record.deadline_ns || x.plan->time_limit_ns != y.plan->time_limit_ns)
      found.push_back(where + ": time limit");
    if (x.plan->after_jobs != y.plan->after_jobs) found.push_back(where + ": jobs before it");
    if (x.tasks.size() != y.tasks.size()) return found.push_back(where + ": number of tasks"), found;
    for (size_t i = 0; i < x.tasks.size(); ++i) {
      if (!Same(x.tasks[i], y.tasks[i])) found.push_back(where + " task " + std::to_string(i));
    }
  }
  const auto same_attempt = [](const OpenAttempt& x, const OpenAttempt& y) {
    return x.task == y.task && x.token == y.token && x.number == y.number && x.worker == y.worker &&
           x.instance == y.instance && x.key == y.key && x.granted == y.granted;
  };
  if (!std::equal(a.open_attempts.begin(), a.open_attempts.end(), b.open_attempts.begin(),
                  b.open_attempts.end(), same_attempt)) {
    found.push_back("open attempts");
  }
  return found;
}

}  // namespace rg::coordinator
