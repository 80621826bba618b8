// Which task goes where. Workers with free slots take turns, the emptiest first; each takes the best
// task it can run: highest priority, then oldest job, then the job's own order.
#include <algorithm>
#include <vector>

#include "coordinator/core/turn.h"

namespace rg::coordinator {

void Turn::Dispatch() {
  std::vector<Worker*> open;
  for (auto& [name, worker] : s_.workers) {
    if (worker.accepts_work()) open.push_back(&worker);
  }
  const auto emptier = [](const Worker* a, const Worker* b) {
    return uint64_t{a->busy()} * b->slots < uint64_t{b->busy()} * a->slots;
  };
  while (!open.empty()) {
    std::stable_sort(open.begin(), open.end(), emptier);
    std::erase_if(open, [this](Worker* worker) { return !AssignOneTo(*worker) || !worker->accepts_work(); });
  }
}

bool Turn::AssignOneTo(Worker& worker) {
  SchedulingClass* best = nullptr;
  for (const uint32_t id : worker.classes) {
    SchedulingClass& cls = s_.classes[id];
    if (cls.ready.empty()) continue;
    if (best == nullptr || *cls.ready.begin() < *best->ready.begin()) best = &cls;
  }
  if (best == nullptr) return false;
  const TaskId task = best->ready.begin()->task;
  best->ready.erase(best->ready.begin());
  GiveTo(worker, *s_.FindJob(JobOf(task)), IndexOf(task));
  return true;
}

void Turn::GiveTo(Worker& worker, Job& job, uint32_t index) {
  if (job.record.phase == JobPhase::kQueued) {
    job.record.started_ns = now_.wall_ns;
    SetJobPhase(job, JobPhase::kRunning, "");
  }
  Task& task = job.tasks[index];
  const Token token = ++s_.last_token;
  const uint32_t number = ++task.attempts;
  Lease& lease = s_.leases[token];
  lease.task = MakeTaskId(job.id, index);
  lease.attempt = number;
  lease.worker = worker.name;
  lease.instance = worker.instance;
  lease.key = worker.key;
  lease.deadline_ns = now_.steady_ns + s_.options.lease_ns();
  lease.started_wall_ns = now_.wall_ns;
  if (task.started_ns == 0) task.started_ns = now_.wall_ns;
  SetStatus(s_, job, index, TaskLeased{token});
  worker.leases.insert(token);
  ++s_.counters.attempts_started;
  Store(InsertAttempt{lease.task, number, token, worker.name, worker.instance, worker.key, now_.wall_ns});
  PersistTask(job, index);
  Send(Assign{worker.instance, lease.task, token, number});
}

}  // namespace rg::coordinator
