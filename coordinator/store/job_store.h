// The reactor's rows in SQLite, and the stored state back out of them. Writes join the transaction
// that the caller has open: durable when that commits. One thread.
#pragma once

#include <cstdint>
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

class JobStore {
 public:
  explicit JobStore(store::Database* database) : db_(database) {}

  // Everything the core needs to go on. kDataLoss names the row that makes no sense.
  Result<StoredState> Load();
  // In order. Results of CommitResult rows are taken from `results`.
  Status Apply(const std::vector<Row>& rows, const ResultsByToken& results);

  // Jobs from before there was a list of inputs get theirs.
  Status ListMissingInputs();
  // The artefacts that jobs refer to, for store::GcOptions::references: inputs, outputs, and what tasks of
  // jobs under way have uploaded. Jobs that ended before `ended_before_ns` (wall time) do not count.
  static std::vector<std::string> ArtifactReferences(int64_t ended_before_ns);

  Result<std::string> Spec(TaskId task);  // serialised TaskSpec
  Result<std::vector<OutputRow>> Outputs(TaskId task);
  // Everything about the tasks from `first` to `last`, in one query per table.
  Result<TaskRows> ReadTasks(TaskId first, TaskId last, bool with_attempts);

  // An older checkpoint of a newer lease's task, or an earlier one of the same lease, is ignored.
  Status SaveCheckpoint(TaskId task, Token token, uint64_t sequence, std::string_view bytes);
  Result<std::string> Checkpoint(TaskId task);  // empty: none

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
  Status LoadJobs(StoredState* out, std::vector<std::shared_ptr<JobPlan>>* plans);
  Status LoadTasks(StoredState* out, const std::vector<std::shared_ptr<JobPlan>>& plans);
  Status LoadOpenAttempts(StoredState* out);

  Status ApplyOne(const InsertJob& row);
  Status ApplyOne(const UpdateJob& row);
  Status ApplyOne(const UpdateTask& row);
  Status ApplyOne(const InsertAttempt& row);
  Status ApplyOne(const GrantAttempt& row);
  Status ApplyOne(const FinishAttempt& row);
  Status ApplyOne(const CommitResult& row);
  Status ApplyOne(const CloseTasks& row);
  Status ApplyOne(const ReopenTasks& row);
  Status ApplyOne(const AppendEvent& row);
  Status InsertTask(TaskId id, const TaskPlan& plan);
  Status InsertInputs(JobId job, std::string_view spec);
  Status TrimLog(TaskId task);

  store::Database* db_;
  const ResultsByToken* results_ = nullptr;  // of the Apply under way
  std::unordered_map<TaskId, int> log_lines_;
};

}  // namespace rg::coordinator
