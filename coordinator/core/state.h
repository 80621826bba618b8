// What is live, as an index in memory: all of it but what is marked volatile comes back from the store after
// a restart (Restore). A job that is over leaves it (Retire) once that is durable; the store goes on knowing
// it, and gives it back for a retry (Recall). Owned by one thread.
#pragma once

#include <array>
#include <compare>
#include <deque>
#include <map>
#include <set>
#include <string>
#include <unordered_map>
#include <utility>
#include <variant>
#include <vector>

#include "coordinator/core/types.h"

namespace rg::coordinator {

// --- a task is in exactly one of these ------------------------------------------------------------

struct TaskWaiting {
  uint32_t parents_left = 0;
};
struct TaskReady {};
struct TaskLeased {
  Token token = 0;  // key of State::leases
};
struct TaskSucceeded {
  Token token = 0;
};
struct TaskFailed {
  bool set_aside = false;
};
struct TaskCancelled {};
// At-most-once, and its worker was lost after it was allowed to start: it may have run. Its worker
// may still return with the lease or the result; until `deadline_ns`, then it counts as failed.
struct TaskUncertain {
  Token token = 0;
};
using TaskStatus =
    std::variant<TaskWaiting, TaskReady, TaskLeased, TaskSucceeded, TaskFailed, TaskCancelled, TaskUncertain>;

struct ChildEdge {
  uint32_t child = 0;
  bool optional = false;
};

struct Task {
  TaskStatus status;
  uint32_t attempts = 0, failures = 0, crashes = 0, losses = 0;
  uint32_t scheduling_class = 0;
  uint32_t stage = 0;  // index in Job::stages
  uint32_t first_child = 0, child_count = 0;
  int64_t started_ns = 0, finished_ns = 0;  // wall time, for people to read
};

TaskPhase PhaseOf(const TaskStatus& status);

struct Job {
  JobId id = 0;
  std::string request_id;
  std::shared_ptr<const JobPlan> plan;  // one TaskPlan per task, same index
  JobRecord record;
  std::vector<Task> tasks;
  std::vector<ChildEdge> children;
  std::vector<std::string> stages;  // in order of first appearance
  uint32_t succeeded = 0, failed = 0, cancelled = 0, leased = 0, uncertain = 0;  // counts of tasks
  double weight_total = 0.0, weight_done = 0.0;
  std::set<JobId> waits_for;  // those of plan->after_jobs that are not over
  int64_t deadline_ns = 0;    // steady time; 0: none
  bool is_overdue = false;    // its time limit is over; nothing of it starts, what was finished may yet come
  uint64_t revision = 1;      // volatile, grows with every change
  // By task that failed: the worker that it failed on last. Volatile.
  std::map<uint32_t, std::string> failed_on;

  uint32_t settled() const { return succeeded + failed + cancelled; }
  const TaskPlan& plan_of(uint32_t index) const { return plan->tasks[index]; }
  int32_t priority_of(uint32_t index) const { return plan_of(index).priority + record.priority_shift; }
  // Nothing of it may start: its ready tasks are in no queue.
  bool is_held() const { return record.phase == JobPhase::kPaused || !waits_for.empty() || is_overdue; }
};

struct Lease {
  TaskId task = 0;
  uint32_t attempt = 0;
  std::string worker;
  std::string instance;
  std::string key;       // of the worker
  bool granted = false;  // at-most-once only: it was allowed to start
  int64_t deadline_ns = 0;
  bool restored = false;  // from before a restart, not confirmed by its worker yet
  // Volatile:
  int64_t named_ns = 0;   // when a heartbeat last named it; 0: none has, since a restart
  bool finished = false;  // and said that it no longer runs: what it came to is on its way
  int64_t started_wall_ns = 0;
  std::string progress_stage;
  double progress_done = 0.0;
  double progress_total = 0.0;
  std::string progress_note;
};

// Tasks that any worker able to run one of them can run all of.
struct SchedulingClass {
  std::string kind;
  std::vector<std::string> tags;  // sorted
  struct Entry {
    int32_t priority;
    TaskId task;
    // Higher priority first, then the older job, then the job's own order.
    bool operator<(const Entry& o) const {
      return priority != o.priority ? priority > o.priority : task < o.task;
    }
  };
  std::set<Entry> ready;
  uint64_t tasks = 0;  // of jobs in memory; 0: the class may be reused for another
  // How long its tasks run, as far as was seen lately; rises at once, falls slowly. Negative: not known.
  // Volatile.
  double seconds = -1.0;
};

// Volatile: workers introduce themselves again after a restart.
struct Worker {
  std::string name;
  std::string instance;
  std::string key;  // only this key may have the name
  // Other processes that would like to have the name, or its robot, and since when. They wait in silence until this
  // one is lost, and are refused when it has been heard of since.
  std::map<std::string, int64_t> rivals;
  std::string host;
  std::string version;
  int64_t pid = 0;
  uint32_t slots = 1;
  std::set<std::string> tags;
  std::set<std::string> kinds;
  bool draining = false;
  std::string drain_reason;
  std::string unable;  // why it can run nothing for now, as it said last; empty: it can
  // Tasks of a kind that failed here in a row, while others finished tasks of that kind.
  struct Failing {
    std::set<TaskId> tasks;
    uint64_t finished_before = 0;  // KindSeconds::finished as the first of them failed
  };
  std::map<std::string, Failing> failing;  // by kind
  std::string suspect;           // why it is given nothing until suspect_until_ns; empty: it is
  int64_t suspect_until_ns = 0;
  uint32_t suspicions = 0;       // since a task last succeeded here: one at a time until then
  bool connected = true;
  int64_t last_seen_ns = 0;
  int64_t since_wall_ns = 0;
  std::set<Token> leases;
  std::set<Token> winding_down;  // revoked, still occupying a slot as far as the worker has said
  uint64_t tasks_done = 0, tasks_failed = 0;
  NodeState node;
  std::string last_error;  // of a task on it
  std::vector<uint32_t> classes;  // scheduling classes it can run

  uint32_t busy() const { return static_cast<uint32_t>(leases.size() + winding_down.size()); }
  std::string held;  // "is held by anna: belt replaced": its robot is; empty: it is not
  const std::string& why_unable() const { return !held.empty() ? held : !unable.empty() ? unable : suspect; }
  bool takes_tasks() const { return connected && !draining && why_unable().empty(); }
  bool accepts_work() const { return takes_tasks() && busy() < (suspicions > 0 ? 1 : slots); }
};

// How many tasks of this class a worker is given beyond each of its slots, to have the next one at hand: an
// assignment takes some milliseconds to become durable. None of a class whose tasks are long or unknown,
// which would wait behind another while a slot elsewhere is free.
uint32_t AheadPerSlot(const SchedulingClass& cls);

struct Options {
  int64_t heartbeat_ns = 2'000'000'000;
  int64_t lease_ns() const { return 2 * heartbeat_ns; }
  // After a restart, how long a lease from before waits for its worker to come back.
  int64_t restart_grace_ns() const { return 2 * lease_ns(); }
  int64_t uncertain_ns = 30'000'000'000;        // how long an uncertain task waits for its worker
  int64_t forget_worker_ns = 3600'000'000'000;  // a lost worker leaves the listing after this
  uint32_t max_losses = 8;                      // lost leases of one task before it is given up
  int64_t suspect_ns = 10'000'000'000;          // a worker where all fails rests first; doubles, to 64 times as long
};

// How long tasks of a kind ran.
struct KindSeconds {
  static constexpr std::array<double, 7> kAtMost = {0.01, 0.1, 1.0, 10.0, 60.0, 600.0, 3600.0};
  std::array<uint64_t, kAtMost.size()> at_most = {};  // each holds those of the ones before
  uint64_t finished = 0;
  double sum = 0.0;
};

struct Counters {
  uint64_t jobs_submitted = 0, jobs_succeeded = 0, jobs_failed = 0, jobs_cancelled = 0;
  uint64_t tasks_committed = 0, tasks_failed = 0, attempts_started = 0, attempts_lost = 0;
  uint64_t results_refused = 0, workers_lost = 0, executors_crashed = 0;
};

struct State {
  Options options;
  std::map<JobId, Job> jobs;
  std::unordered_map<std::string, JobId> job_by_request;
  std::map<TaskId, std::vector<JobId>> jobs_of_task;  // JobPlan::parent, the other way round
  std::map<JobId, std::set<JobId>> jobs_waiting_for;  // Job::waits_for, the other way round
  std::unordered_map<Token, Lease> leases;            // leased and uncertain tasks
  std::map<std::string, Worker> workers;              // by name
  std::unordered_map<std::string, std::string> worker_by_instance;
  std::map<std::string, RobotHold> holds;  // by robot
  std::deque<SchedulingClass> classes;
  std::map<std::pair<std::string, std::vector<std::string>>, uint32_t> class_index;
  std::vector<uint32_t> free_classes;
  JobId last_job = 0;
  JobId newest_of_clients = 0;  // the newest job that a client submitted, in memory or not; 0: none
  Token last_token = 0;
  uint64_t revision = 0;
  Counters counters;             // volatile
  std::map<std::string, KindSeconds> kinds;  // volatile: of tasks that were finished
  bool dispatch_needed = false;  // within one event
  std::vector<JobId> ended;      // since the shell last looked: to be retired; volatile

  Job* FindJob(JobId id);
  const Job* FindJob(JobId id) const;
  Worker* FindWorkerByInstance(const std::string& instance);
  // The lease if `token` is valid for that process; else null.
  Lease* FindLease(Token token, const std::string& instance);
  // Succeeded, failed or cancelled.
  bool IsSettled(TaskId task) const;
  // Whether the task runs, as far as anybody knows, under this lease.
  bool Holds(TaskId task, Token token) const;
};

// Takes a job that is over out of memory; what is durable of it must be so before. Nothing if it is not over.
void Retire(State& state, JobId id);
// Puts one back, over as it is, to be commanded. Without its tasks it can only be told that it is over.
Job& Recall(State& state, const StoredJob& stored);
JobCounts CountsOf(const Job& job);
// Builds the job's index from its plan: all tasks waiting, scheduling classes made.
void IndexJob(State& state, Job& job);
// From now on it waits for those of the jobs it comes after that are in memory and not over.
void AwaitJobs(State& state, Job& job);
// It waits for none any more.
void StopAwaiting(State& state, Job& job);
// Inserts a ready task into, or removes it from, its class. Tasks of jobs that are held are in no queue.
void Enqueue(State& state, Job& job, uint32_t index);
void Dequeue(State& state, Job& job, uint32_t index);
// Of all its ready tasks.
void DequeueAll(State& state, Job& job);
// From now on nothing of it starts: its time limit is over.
void HoldOverdue(State& state, Job& job);
// Sets the status and keeps the job's counts and revision.
void SetStatus(State& state, Job& job, uint32_t index, TaskStatus status);
// How many parents the task still has to wait for, from their statuses.
uint32_t CountOpenParents(const Job& job, uint32_t index);
bool CanRun(const Worker& worker, const SchedulingClass& cls);
// Worker::held, from State::holds.
void MarkHeld(const State& state, Worker& worker);
TaskRecord RecordOf(const Job& job, uint32_t index);

// After the state was read back in the middle of work (nothing of the last batch became durable): the
// workers of `before` are still there, with those of their leases that still hold.
void KeepWorkers(const State& before, State& after, Now now);

// The state a store describes. Leases from before wait Options::restart_grace_ns for their workers.
State Restore(const StoredState& stored, const Options& options, Now now);
// What a store would give back for this state, for comparison: Restore is its inverse.
StoredState Describe(const State& state);
// One line per difference in what must survive a restart; empty: none.
std::vector<std::string> Differences(const StoredState& a, const StoredState& b);

}  // namespace rg::coordinator
