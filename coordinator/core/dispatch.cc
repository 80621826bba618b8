// Which task goes where. Workers with free slots take turns, the emptiest first; each takes the best
// task it can run: highest priority, then oldest job, then the job's own order.
#include <algorithm>
#include <vector>

#include "coordinator/core/turn.h"

namespace rg::coordinator {

uint32_t AheadPerSlot(const SchedulingClass& cls) {
  constexpr double kAheadSeconds = 0.02;  // of work that waits at the worker
  constexpr double kMost = 16.0;
  if (cls.seconds < 0.0 || cls.seconds > kAheadSeconds) return 0;
  return static_cast<uint32_t>(std::min(kMost, kAheadSeconds / std::max(cls.seconds, 1e-6)));
}

// Free slots first, everywhere; then what is short is given ahead.
void Turn::Dispatch() {
  FillSlots(false);
  FillSlots(true);
}

void Turn::FillSlots(bool ahead) {
  const bool anything = std::any_of(s_.classes.begin(), s_.classes.end(), [&](const SchedulingClass& cls) {
    return !cls.ready.empty() && (!ahead || AheadPerSlot(cls) > 0);
  });
  if (!anything) return;
  std::vector<Worker*> open;
  for (auto& [name, worker] : s_.workers) {
    if (ahead ? worker.connected && !worker.draining : worker.accepts_work()) open.push_back(&worker);
  }
  const auto emptier = [](const Worker* a, const Worker* b) {
    return uint64_t{a->busy()} * b->slots < uint64_t{b->busy()} * a->slots;
  };
  while (!open.empty()) {
    std::stable_sort(open.begin(), open.end(), emptier);
    std::erase_if(open, [&](Worker* worker) {
      return !AssignOneTo(*worker, ahead) || (!ahead && !worker->accepts_work());
    });
  }
}

bool Turn::AssignOneTo(Worker& worker, bool ahead) {
  SchedulingClass* best = nullptr;
  for (const uint32_t id : worker.classes) {
    SchedulingClass& cls = s_.classes[id];
    if (cls.ready.empty()) continue;
    if (best == nullptr || *cls.ready.begin() < *best->ready.begin()) best = &cls;
  }
  if (best == nullptr) return false;
  const TaskId task = best->ready.begin()->task;
  Job& job = *s_.FindJob(JobOf(task));
  if (ahead &&
      (worker.busy() >= worker.slots * (1 + AheadPerSlot(*best)) || job.plan_of(IndexOf(task)).at_most_once))
    return false;
  best->ready.erase(best->ready.begin());
  GiveTo(worker, job, IndexOf(task));
  return true;
}

void Turn::GiveTo(Worker& worker, Job& job, uint32_t index) {
  if (job.record.phase == JobPhase::kQueued) {
    job.record.started_ns = now_.wall_ns;
    StartTheClock(job);
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
