#include "coordinator/core/invariants.h"

namespace rg::coordinator {
namespace {

class Inspection {
 public:
  explicit Inspection(const State& state) : s_(state) {}

  std::vector<std::string> Run() {
    for (const auto& [id, job] : s_.jobs) CheckJob(job);
    CheckLeases();
    CheckWorkers();
    CheckQueues();
    return std::move(broken_);
  }

 private:
  // `what` makes the line; only called for a broken promise.
  template <class What>
  void Expect(bool holds, What what) {
    if (!holds) [[unlikely]]
      broken_.emplace_back(what());
  }

  void CheckJob(const Job& job) {
    const auto where = [&] { return "job " + std::to_string(job.id); };
    uint32_t open = 0, leased = 0, failed = 0, uncertain = 0;
    for (uint32_t i = 0; i < job.tasks.size(); ++i) {
      CheckTask(job, i);
      const TaskPhase phase = PhaseOf(job.tasks[i].status);
      leased += phase == TaskPhase::kLeased;
      failed += phase == TaskPhase::kFailed;
      uncertain += phase == TaskPhase::kUncertain;
      open += phase == TaskPhase::kWaiting || phase == TaskPhase::kReady || phase == TaskPhase::kLeased ||
              phase == TaskPhase::kUncertain;
    }
    Expect(!IsFinal(job.record.phase) || open == 0, [&] { return where() + " is over but has open tasks"; });
    Expect(IsFinal(job.record.phase) || open > 0,
           [&] { return where() + " has nothing left to do but is not over"; });
    Expect(job.record.phase != JobPhase::kQueued || leased == 0,
           [&] { return where() + " is queued but runs"; });
    Expect(job.leased == leased && job.failed == failed && job.uncertain == uncertain,
           [&] { return where() + ": counts"; });
    Expect(job.settled() + open == job.tasks.size(), [&] { return where() + ": settled count"; });
    CheckParent(job);
    CheckJobsBefore(job, leased);
  }

  // A job that a task submitted goes on for as long as that may still run, and no longer.
  void CheckParent(const Job& job) {
    if (job.plan->parent == 0) return;
    const auto where = [&] { return "job " + std::to_string(job.id); };
    if (IsFinal(job.record.phase)) return;  // its parent may have left memory
    const Job* parent = s_.FindJob(JobOf(job.plan->parent));
    Expect(parent != nullptr && parent->id < job.id && IndexOf(job.plan->parent) < parent->tasks.size(),
           [&] { return where() + " was submitted by a task that there is not"; });
    if (parent == nullptr) return;
    Expect(!s_.IsSettled(job.plan->parent),
           [&] { return where() + " goes on though the task that submitted it is over"; });
  }

  void CheckJobsBefore(const Job& job, uint32_t leased) {
    const auto where = [&] { return "job " + std::to_string(job.id); };
    Expect(job.waits_for.empty() || leased == 0,
           [&] { return where() + " runs before those it comes after"; });
    Expect(!IsFinal(job.record.phase) || job.waits_for.empty(),
           [&] { return where() + " is over but waits"; });
    for (const JobId id : job.waits_for) {
      const Job* before = s_.FindJob(id);
      const auto index = s_.jobs_waiting_for.find(id);
      Expect(before != nullptr && !IsFinal(before->record.phase),
             [&] { return where() + " waits for job " + std::to_string(id) + ", which is over"; });
      Expect(index != s_.jobs_waiting_for.end() && index->second.count(job.id) > 0,
             [&] { return where() + " would not be told of the end of job " + std::to_string(id); });
    }
    if (IsFinal(job.record.phase)) return;
    const bool counts = job.plan->time_limit_ns != 0 && job.record.started_ns != 0;
    Expect(counts == (job.deadline_ns != 0) && counts == (job.record.deadline_ns != 0),
           [&] { return where() + ": time limit"; });
    Expect(!job.is_overdue || counts, [&] { return where() + " is overdue without a time limit"; });
  }

  void CheckTask(const Job& job, uint32_t index) {
    const Task& task = job.tasks[index];
    const TaskPlan& plan = job.plan_of(index);
    const auto where = [&] { return "job " + std::to_string(job.id) + " task " + plan.name; };
    const uint32_t open_parents = CountOpenParents(job, index);
    if (const auto* waiting = std::get_if<TaskWaiting>(&task.status)) {
      Expect(waiting->parents_left == open_parents, [&] { return where() + ": count of open parents"; });
      Expect(open_parents > 0, [&] { return where() + " waits for nothing"; });
    }
    const TaskPhase phase = PhaseOf(task.status);
    const bool started =
        phase == TaskPhase::kReady || phase == TaskPhase::kLeased || phase == TaskPhase::kUncertain;
    Expect(!started || open_parents == 0, [&] { return where() + " started before its parents committed"; });
    // A retry may reopen an optional parent that a done task did without, never one that it needed.
    Expect(phase != TaskPhase::kSucceeded || RequiredParentsSucceeded(job, index),
           [&] { return where() + " is done but a parent is not"; });
    Expect(task.failures <= plan.max_attempts, [&] { return where() + ": more failures than attempts"; });
    Expect(task.crashes <= plan.crash_limit, [&] { return where() + ": more crashes than the limit"; });
    const bool over_limit = task.failures >= plan.max_attempts || task.crashes >= plan.crash_limit;
    Expect(!over_limit || phase == TaskPhase::kFailed, [&] { return where() + " goes on past its limit"; });
    Expect(phase != TaskPhase::kUncertain || plan.at_most_once,
           [&] { return where() + " is uncertain but may be repeated"; });
    CheckLeaseOf(job, index, where);
  }

  static bool RequiredParentsSucceeded(const Job& job, uint32_t index) {
    for (const ParentEdge& edge : job.plan_of(index).parents) {
      if (!edge.optional && PhaseOf(job.tasks[edge.parent].status) != TaskPhase::kSucceeded) return false;
    }
    return true;
  }

  template <class Where>
  void CheckLeaseOf(const Job& job, uint32_t index, const Where& where) {
    const TaskRecord record = RecordOf(job, index);
    if (record.phase != TaskPhase::kLeased && record.phase != TaskPhase::kUncertain) return;
    const auto lease = s_.leases.find(record.token);
    Expect(lease != s_.leases.end() && lease->second.task == MakeTaskId(job.id, index),
           [&] { return where() + " has no lease"; });
    if (lease == s_.leases.end()) return;
    Expect(record.phase != TaskPhase::kUncertain || lease->second.granted,
           [&] { return where() + " is uncertain but never started"; });
    Expect(lease->second.attempt == record.attempts,
           [&] { return where() + " is held under an older attempt"; });
  }

  void CheckLeases() {
    for (const auto& [token, lease] : s_.leases) {
      const auto where = [token = token] { return "lease " + std::to_string(token); };
      Expect(token <= s_.last_token, [&] { return where() + " is from the future"; });
      const Job* job = s_.FindJob(JobOf(lease.task));
      Expect(job != nullptr && IndexOf(lease.task) < job->tasks.size(),
             [&] { return where() + " is for no task"; });
      if (job == nullptr) continue;
      Expect(RecordOf(*job, IndexOf(lease.task)).token == token,
             [&] { return where() + " is not the one its task knows"; });
    }
  }

  void CheckWorkers() {
    for (const auto& [name, worker] : s_.workers) {
      Expect(worker.connected || worker.leases.empty(),
             [&name = name] { return "worker " + name + " is lost but holds leases"; });
      for (const uint32_t id : worker.classes) {
        Expect(CanRun(worker, s_.classes[id]),
               [&name = name] { return "worker " + name + " is offered what it cannot run"; });
      }
      for (const Token token : worker.leases) {
        const auto lease = s_.leases.find(token);
        Expect(lease != s_.leases.end() && lease->second.instance == worker.instance, [&name = name, token] {
          return "worker " + name + " holds lease " + std::to_string(token) + ", which is not its own";
        });
      }
    }
  }

  void CheckQueues() {
    size_t queued = 0, in_classes = 0, in_jobs = 0;
    for (const auto& [id, job] : s_.jobs) in_jobs += job.tasks.size();
    for (const SchedulingClass& cls : s_.classes) {
      queued += cls.ready.size();
      in_classes += cls.tasks;
      for (const auto& entry : cls.ready) {
        const Job* job = s_.FindJob(JobOf(entry.task));
        Expect(job != nullptr && std::holds_alternative<TaskReady>(job->tasks[IndexOf(entry.task)].status),
               [&] { return std::string("a task is queued but not ready"); });
        Expect(job == nullptr || job->priority_of(IndexOf(entry.task)) == entry.priority,
               [&] { return std::string("a task is queued under another priority than its own"); });
      }
    }
    Expect(in_classes == in_jobs, [&] { return std::string("tasks of scheduling classes: count"); });
    Expect(s_.class_index.size() + s_.free_classes.size() == s_.classes.size(),
           [&] { return std::string("a scheduling class is neither used nor free"); });
    Expect(s_.job_by_request.size() == s_.jobs.size(),
           [&] { return std::string("request ids and jobs in memory: count"); });
    size_t ready = 0;
    for (const auto& [id, job] : s_.jobs) {
      if (job.is_held()) continue;
      for (const Task& task : job.tasks) ready += std::holds_alternative<TaskReady>(task.status);
    }
    Expect(queued == ready, [&] { return std::string("a ready task is in no queue"); });
    for (const auto& [before, waiting] : s_.jobs_waiting_for) {
      for (const JobId id : waiting) {
        const Job* job = s_.FindJob(id);
        Expect(job != nullptr && job->waits_for.count(before) > 0, [id, before = before] {
          return "job " + std::to_string(id) + " does not wait for job " + std::to_string(before);
        });
      }
    }
    Expect(!s_.dispatch_needed, [&] { return std::string("dispatch was left undone"); });
  }

  const State& s_;
  std::vector<std::string> broken_;
};

}  // namespace

std::vector<std::string> BrokenInvariants(const State& state) { return Inspection(state).Run(); }

}  // namespace rg::coordinator
