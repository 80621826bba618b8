// The reactor's rows in SQLite, and the stored state back out of them. Writes join the transaction
// that the caller has open: durable when that commits. One thread.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <unordered_map>
#include <vector>

#include "common/base/status.h"
#include "common/store/database.h"
#include "coordinator/core/events.h"

namespace rg::coordinator {

struct OutputRow {
  std::string name, kind, sha256, metadata_json;
  int64_t size = 0;
};
// What a finished attempt brought; stored when the reactor commits it.
struct ResultRow {
  std::vector<OutputRow> outputs;
  std::string summary_json = "{}";
  double seconds = 0.0;
};
using ResultsByToken = std::unordered_map<Token, ResultRow>;

struct StoredTask {
  TaskId task = 0;
  TaskPlan plan;
  TaskRecord record;
};
struct StageRow {
  std::string name;
  uint32_t total = 0, done = 0, failed = 0;
  double weight = 0.0, weight_done = 0.0;
  int64_t started_ns = 0, finished_ns = 0;  // wall times; 0: not yet
};

struct TaskDetail {
  std::string reason;
  int64_t started_ns = 0, finished_ns = 0;
  std::string summary_json;  // empty: no result
};
struct AttemptRow {
  uint32_t number = 0;
  Token token = 0;
  std::string worker, error;
  int64_t leased_ns = 0, finished_ns = 0;
  Outcome outcome = Outcome::kOpen;
};
// Of a range of tasks; outputs and attempts in their order.
struct TaskRows {
  std::unordered_map<TaskId, TaskDetail> details;
  std::multimap<TaskId, OutputRow> outputs;
  std::multimap<TaskId, AttemptRow> attempts;
};
struct LogRow {
  TaskId task = 0;
  uint32_t attempt = 0;
  int64_t wall_ns = 0;
  uint64_t sequence = 0;
  std::string text;
  std::string name;  // of the task; only where it is read
};
struct EventRow {
  int64_t id = 0;
  AppendEvent event;
};
struct CheckpointRow {
  Token token = 0;
  uint64_t sequence = 0;
  std::string bytes;
};

// A job as a listing shows it, whether it is in memory or not.
struct JobRow {
  JobId job = 0;
  std::string request_id;
  std::shared_ptr<const JobPlan> plan;  // without tasks
  JobRecord record;
  uint32_t total = 0;  // tasks
  JobCounts counts;    // as of the last change of its record
  int64_t archived_ns = 0;
};
struct JobFilter {
  std::vector<JobId> ids;        // empty: any
  std::vector<JobPhase> phases;  // empty: any
  JobId parent_job = 0;          // without ids: what tasks of this job submitted; 0: what clients did
  bool any_parent = false;       // whoever submitted it
  JobId before = 0;              // only older ones; 0: from the newest
  int64_t since_ns = 0;          // submitted then or later
  std::string by;                // JobPlan::submitted_by is this name, with or without a remark; empty: anybody
};

class JobStore {
 public:
  explicit JobStore(store::Database* database) : db_(database) {}

  // Everything the core needs to go on: the jobs that are not over. kDataLoss names the row that makes no
  // sense.
  Result<StoredState> Load();
  // One job, whatever its phase, as Load gives it; with its tasks or without. kNotFound.
  Result<StoredJob> LoadJob(JobId job, bool with_tasks);
  // Newest first, as long as `take` returns true.
  Status ListJobs(const JobFilter& filter, const std::function<bool(const JobRow&)>& take);
  Result<JobRow> FindJob(JobId job);                          // kNotFound
  Result<JobRow> FindRequest(const std::string& request_id);  // kNotFound
  // The lease under which the task was committed; 0: it was not.
  Result<Token> CommittedToken(TaskId task);
  // In order. Results of CommitResult rows are taken from `results`.
  Status Apply(const std::vector<Row>& rows, const ResultsByToken& results);

  // Jobs from before there was a list of inputs get theirs.
  Status ListMissingInputs();
  // The artefacts that jobs refer to, for store::GcOptions::references: inputs, outputs, and what tasks of
  // jobs under way have uploaded. Jobs that ended before `ended_before_ns` (wall time) do not count.
  static std::vector<std::string> ArtifactReferences(int64_t ended_before_ns);

  Result<std::string> Spec(TaskId task);  // serialised TaskSpec
  Result<std::vector<OutputRow>> Outputs(TaskId task);
  // The tasks from `first` to `last` as they were submitted and as they stand.
  Result<std::vector<StoredTask>> ReadPlans(TaskId first, TaskId last);
  // In order of first appearance.
  Result<std::vector<StageRow>> Stages(JobId job);
  // Everything else about them, in one query per table.
  Result<TaskRows> ReadTasks(TaskId first, TaskId last, bool with_attempts);

  // An older checkpoint of a newer lease's task, or an earlier one of the same lease, is ignored.
  Status SaveCheckpoint(TaskId task, Token token, uint64_t sequence, std::string_view bytes);
  Result<std::string> Checkpoint(TaskId task);  // empty: none

  // --- archive (job_archive.cc): tasks of jobs that are over, moved from their rows into one blob for so
  // many.
  static constexpr uint32_t kArchivedTogether = 1000;
  // Empty: nothing of the job is archived.
  Result<std::string> ArchivedOverview(JobId job);
  Result<std::string> ArchivedTasks(TaskId first);
  // The first index whose rows are still there.
  Result<uint32_t> FirstUnarchived(JobId job);
  Status BeginArchive(JobId job, std::string_view overview);
  // `tasks` stands for the rows from `first` to `last`, which go: with specifications, attempts, results,
  // outputs, checkpoints and log lines.
  Status Archive(TaskId first, TaskId last, std::string_view tasks);
  // Nothing of its rows is left; its events go too.
  Status EndArchive(JobId job, int64_t wall_ns);
  // The next job to archive: the one that ended first, if it did before `before_ns`, or whenever it ended if
  // more than `max_tasks` tasks of such jobs are not archived (0: no limit). 0: there is none.
  Result<JobId> NextToArchive(int64_t before_ns, int64_t max_tasks);
  // Wall time of the oldest event of no job; 0: there is none.
  Result<int64_t> OldestEvent();
  // Events of no job that are older, some at a time. How many went.
  Result<int> DropOldEvents(int64_t before_ns, int limit);

  // Forgets what it counted of tasks of a job that has left memory.
  void ForgetLogCounts(JobId job);
  // Keeps about the newest kMaxLogLines of each task.
  static constexpr int kMaxLogLines = 4000;
  Status AppendLog(const LogRow& row);
  // Whether there is room for about so many bytes more: they are written, durably, and removed again.
  Status ProbeRoom(int64_t bytes);
  // kNotFound: the job has no task of that name.
  Result<TaskId> FindTask(JobId job, const std::string& name);
  Result<std::vector<LogRow>> Logs(TaskId first, TaskId last, uint64_t after_sequence, int limit);
  // job 0: all.
  Result<std::vector<EventRow>> Events(JobId job, int64_t after_id, int limit);

 private:
  Status ReadJobs(std::string_view where, const std::function<void(store::Statement&)>& bind,
                  const std::function<bool(JobRow)>& take);
  Status LoadTasks(StoredJob* job, JobPlan* plan);
  Status LoadOpenAttempts(StoredState* out);
  Status LoadHighWater(StoredState* out);
  Status LoadHolds(StoredState* out);

  Status ApplyOne(const InsertJob& row);
  Status ApplyOne(const UpdateJob& row);
  Status ApplyOne(const UpdateTask& row);
  Status ApplyOne(const InsertAttempt& row);
  Status ApplyOne(const GrantAttempt& row);
  Status ApplyOne(const FinishAttempt& row);
  Status ApplyOne(const CommitResult& row);
  Status ApplyOne(const CloseTasks& row);
  Status ApplyOne(const ReopenTasks& row);
  Status ApplyOne(const SetHold& row);
  Status ApplyOne(const AppendEvent& row);
  Status InsertTask(TaskId id, const TaskPlan& plan);
  Status InsertInputs(JobId job, std::string_view spec);
  Status TrimLog(TaskId task);

  store::Database* db_;
  const ResultsByToken* results_ = nullptr;  // of the Apply under way
  std::map<TaskId, int> log_lines_;
};

}  // namespace rg::coordinator
