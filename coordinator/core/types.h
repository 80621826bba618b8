// The words of the coordinator's core: identifiers, time, what a submitted job is, what is durable.
// Plain data, no behaviour, no I/O.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

namespace rg::coordinator {

inline constexpr char kRobotTag[] = "robot:";  // of agents, with the name of their robot

inline constexpr char kWaitingStage[] = "waiting";  // of a task that runs, and does not go on: its note says why

using JobId = int64_t;     // 1, 2, 3, … in order of submission; 0: none
using TaskId = int64_t;    // JobId · 2^24 + index in the job's list of tasks
using Token = uint64_t;    // fencing token: one per attempt, grows over all tasks; 0: none
using ReplyTo = uint64_t;  // the shell's handle of a request that waits for its answer; 0: nobody

constexpr int kTaskIndexBits = 24;
constexpr uint32_t kMaxTasksPerJob = 1u << kTaskIndexBits;
constexpr TaskId MakeTaskId(JobId job, uint32_t index) { return (job << kTaskIndexBits) | index; }
constexpr JobId JobOf(TaskId task) { return task >> kTaskIndexBits; }
constexpr uint32_t IndexOf(TaskId task) { return static_cast<uint32_t>(task & (kMaxTasksPerJob - 1)); }

// A worker's machine, as it says itself; for people to read.
struct NodeState {
  uint64_t disk_free_bytes = 0, memory_free_bytes = 0;
  double load = 0.0;
  std::string robot;  // of an agent: "armed", or why nothing may move; empty: not known
};

// Leases live on the steady clock, people read the wall clock.
struct Now {
  int64_t steady_ns = 0;
  int64_t wall_ns = 0;
};

// The numbers are those of the wire and of the database: frozen.
enum class JobPhase : int {
  kQueued = 1,
  kRunning = 2,
  kPaused = 3,
  kSucceeded = 4,
  kFailed = 5,
  kCancelled = 6
};
enum class TaskPhase : int {
  kWaiting = 1,
  kReady = 2,
  kLeased = 3,
  kSucceeded = 4,
  kFailed = 5,
  kCancelled = 6,
  kUncertain = 7
};
enum class Outcome : int {
  kOpen = 0,
  kSucceeded = 1,
  kFailed = 2,
  kCrashed = 3,
  kTimedOut = 4,
  kLost = 5,
  kCancelled = 6
};

constexpr bool IsFinal(JobPhase p) {
  return p == JobPhase::kSucceeded || p == JobPhase::kFailed || p == JobPhase::kCancelled;
}

struct ParentEdge {
  uint32_t parent = 0;  // index in the job
  bool optional = false;
};

// A task as the core needs it. What it computes (payload, inputs) stays in the store.
struct TaskPlan {
  std::string name;
  std::string stage;
  std::string kind;
  std::vector<std::string> required_tags;
  std::vector<ParentEdge> parents;  // without repeats, every parent before its child is not required
  int32_t priority = 0;             // the job's included
  uint32_t max_attempts = 3;
  uint32_t crash_limit = 3;
  bool at_most_once = false;
  double weight = 1.0;
};

struct JobPlan {
  std::string kind;
  std::string name;
  std::string submitted_by;
  std::string spec_json;
  int32_t priority = 0;
  std::vector<std::string> tags;
  std::map<std::string, std::string> labels;
  // The task that submitted it while it ran; 0: a client did. Such a job is over when the task is.
  TaskId parent = 0;
  std::string content;  // hash of what was asked for, without who asked; empty: not known (older rows)
  int64_t time_limit_ns = 0;      // from its first start to its end; 0: none
  std::vector<JobId> after_jobs;  // earlier ones, which must have succeeded before anything of it starts
  std::vector<TaskPlan> tasks;
};
// Opaque to the core: one serialised specification per task. Not kept in memory.
using TaskSpecs = std::vector<std::string>;

// --- what is durable ---------------------------------------------------------------------------

struct InsertJob {
  JobId job = 0;
  std::string request_id;
  int64_t submitted_ns = 0;
  std::shared_ptr<const JobPlan> plan;
  std::shared_ptr<const TaskSpecs> specs;
};

struct JobRecord {
  JobPhase phase = JobPhase::kQueued;
  std::string reason;
  int64_t submitted_ns = 0;
  int64_t started_ns = 0;
  int64_t finished_ns = 0;
  int32_t priority_shift = 0;  // added to the priorities of the plan: the job's was changed later
  int64_t deadline_ns = 0;     // wall time at which it fails; 0: it has not started, or has no limit
};
// What a listing says of a job that has left memory.
struct JobCounts {
  uint32_t succeeded = 0, failed = 0;  // tasks
  double progress = 0.0;               // 0 to 1, by weight
};
struct UpdateJob {
  JobId job = 0;
  JobRecord record;
  JobCounts counts;
};

// Waiting and ready are told apart by the parents' phases, not by what is stored.
struct TaskRecord {
  TaskPhase phase = TaskPhase::kWaiting;
  uint32_t attempts = 0;  // leases ever given
  uint32_t failures = 0;  // of these: ended with an error or a timeout, since the last consent
  uint32_t crashes = 0;   // of these: killed their executor, since the last consent
  uint32_t losses = 0;    // of these: the worker was lost
  Token token = 0;        // of the current lease (leased, uncertain) or of the committed attempt
  bool set_aside = false;
  // Wall times of the first lease and of the end, 0: not yet. Kept by the store from UpdateTask::wall_ns
  // and CloseTasks::wall_ns; for people to read, nothing is decided by them.
  int64_t started_ns = 0, finished_ns = 0;
};
struct UpdateTask {
  TaskId task = 0;
  TaskRecord record;
  std::string reason;
  int64_t wall_ns = 0;
};

struct InsertAttempt {
  TaskId task = 0;
  uint32_t number = 0;
  Token token = 0;
  std::string worker;
  std::string instance;
  std::string key;  // with which the worker came; empty: without one
  int64_t wall_ns = 0;
};
struct GrantAttempt {  // the at-most-once attempt may start: from here on it may have run
  Token token = 0;
  int64_t wall_ns = 0;
};
struct FinishAttempt {
  Token token = 0;
  Outcome outcome = Outcome::kOpen;
  std::string error;
  int64_t wall_ns = 0;
};
// Every task of the job that is not settled becomes cancelled, its open attempt with it.
struct CloseTasks {
  JobId job = 0;
  std::string reason;
  int64_t wall_ns = 0;
};
// Every failed, cancelled or uncertain task of the job waits again, with its counts at zero.
struct ReopenTasks {
  JobId job = 0;
};
// The outputs and the summary of the message that is being handled become those of the task.
struct CommitResult {
  TaskId task = 0;
  Token token = 0;
  int64_t wall_ns = 0;
};
// Nothing moves the robot until somebody releases it.
struct RobotHold {
  std::string reason, by;
  int64_t since_ns = 0;  // wall time
};
struct SetHold {
  std::string robot;
  RobotHold hold;
  bool released = false;
};
struct AppendEvent {
  int64_t wall_ns = 0;
  JobId job = 0;
  std::string task;
  std::string worker;
  std::string kind;
  std::string detail;
};

// --- what a store gives back -------------------------------------------------------------------

struct OpenAttempt {
  TaskId task = 0;
  Token token = 0;
  uint32_t number = 0;
  std::string worker;
  std::string instance;
  std::string key;
  bool granted = false;
};
struct StoredJob {
  JobId job = 0;
  std::string request_id;
  JobRecord record;
  std::shared_ptr<const JobPlan> plan;
  std::vector<TaskRecord> tasks;
};
struct StoredState {
  std::vector<StoredJob> jobs;  // by id; those that are not over
  std::vector<OpenAttempt> open_attempts;
  Token last_token = 0;
  JobId last_job = 0;
  JobId newest_of_clients = 0;  // 0: there is none
  std::map<std::string, RobotHold> holds;
};

}  // namespace rg::coordinator
