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
  slots_of_all_ = 0;
  for (const auto& [name, worker] : s_.workers) {
    if (worker.takes_tasks()) slots_of_all_ += worker.slots;
  }
  FillSlots(true);
}

// Of tasks that run for less than a second one is at hand for each slot while there are many: whoever has a
// slot free meanwhile finds another, and none waits behind one that takes unexpectedly long (workers give it
// back).
uint32_t Turn::AheadNow(const SchedulingClass& cls) const {
  constexpr double kShort = 1.0;
  const uint32_t always = AheadPerSlot(cls);
  const bool are_many = cls.ready.size() > slots_of_all_;
  return always > 0 ? always : cls.seconds >= 0.0 && cls.seconds < kShort && are_many ? 1 : 0;
}

void Turn::FillSlots(bool ahead) {
  const bool anything = std::any_of(s_.classes.begin(), s_.classes.end(), [&](const SchedulingClass& cls) {
    return !cls.ready.empty() && (!ahead || AheadNow(cls) > 0);
  });
  if (!anything) return;
  std::vector<Worker*> open;
  for (auto& [name, worker] : s_.workers) {
    if (ahead ? worker.takes_tasks() && worker.suspicions == 0 : worker.accepts_work()) open.push_back(&worker);
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

// Whether the task failed on this worker and another one can try it: what is wrong may be the worker (a full
// disk, a library that is missing), which would fail one task after another and so be free for the next.
bool Turn::IsForOthers(const SchedulingClass& cls, TaskId task, const Worker& worker) const {
  const Job& job = *s_.FindJob(JobOf(task));
  const auto failed = job.failed_on.find(IndexOf(task));
  if (failed == job.failed_on.end() || failed->second != worker.name) return false;
  return std::any_of(s_.workers.begin(), s_.workers.end(), [&](const auto& other) {
    return other.first != worker.name && other.second.takes_tasks() && CanRun(other.second, cls);
  });
}

// The first task of the class for this worker, or the end. Looks at a few: the others wait for their turn.
std::set<SchedulingClass::Entry>::const_iterator Turn::FirstFor(const Worker& worker,
                                                                const SchedulingClass& cls) const {
  constexpr int kLooks = 64;
  int looks = 0;
  for (auto entry = cls.ready.begin(); entry != cls.ready.end() && looks < kLooks; ++entry, ++looks) {
    if (!IsForOthers(cls, entry->task, worker)) return entry;
  }
  return cls.ready.end();
}

bool Turn::AssignOneTo(Worker& worker, bool ahead) {
  SchedulingClass* best = nullptr;
  std::set<SchedulingClass::Entry>::const_iterator first;
  for (const uint32_t id : worker.classes) {
    SchedulingClass& cls = s_.classes[id];
    const auto candidate = FirstFor(worker, cls);
    if (candidate == cls.ready.end()) continue;
    if (best == nullptr || *candidate < *first) best = &cls, first = candidate;
  }
  if (best == nullptr) return false;
  const TaskId task = first->task;
  Job& job = *s_.FindJob(JobOf(task));
  if (ahead &&
      (worker.busy() >= worker.slots * (1 + AheadNow(*best)) || job.plan_of(IndexOf(task)).at_most_once))
    return false;
  best->ready.erase(first);
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
