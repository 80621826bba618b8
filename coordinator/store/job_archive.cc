// The part of JobStore that moves what is over out of the way.
#include "coordinator/store/job_store.h"

namespace rg::coordinator {
namespace {

// Numbers that went with their rows must not be given again.
constexpr const char* kMark =
    "INSERT INTO high_water (name, value) VALUES (?1, ?2) "
    "ON CONFLICT (name) DO UPDATE SET value = max(value, excluded.value)";

}  // namespace

Result<std::string> JobStore::ArchivedOverview(JobId job) {
  RG_ASSIGN_OR_RETURN(auto row, db_->Prepare("SELECT overview FROM archived_jobs WHERE job=?"));
  row.Bind(1, job);
  RG_ASSIGN_OR_RETURN(const bool found, row.Step());
  return found ? std::string(row.Blob(0)) : std::string();
}

Result<std::string> JobStore::ArchivedTasks(TaskId first) {
  RG_ASSIGN_OR_RETURN(auto row, db_->Prepare("SELECT tasks FROM archived_tasks WHERE first=?"));
  row.Bind(1, first);
  RG_ASSIGN_OR_RETURN(const bool found, row.Step());
  if (!found) return NotFoundError("no archived tasks begin at " + std::to_string(first));
  return std::string(row.Blob(0));
}

Result<uint32_t> JobStore::FirstUnarchived(JobId job) {
  RG_ASSIGN_OR_RETURN(auto row, db_->Prepare("SELECT next_task FROM archived_jobs WHERE job=?"));
  row.Bind(1, job);
  RG_ASSIGN_OR_RETURN(const bool found, row.Step());
  return found ? static_cast<uint32_t>(row.Int(0)) : 0u;
}

Status JobStore::BeginArchive(JobId job, std::string_view overview) {
  RG_ASSIGN_OR_RETURN(
      auto insert,
      db_->Prepare("INSERT OR IGNORE INTO archived_jobs (job, overview, next_task) VALUES (?,?,0)"));
  return insert.Bind(1, job).BindBlob(2, overview).Run();
}

Status JobStore::Archive(TaskId first, TaskId last, std::string_view tasks) {
  RG_ASSIGN_OR_RETURN(auto insert, db_->Prepare("INSERT INTO archived_tasks (first, tasks) VALUES (?,?)"));
  RG_RETURN_IF_ERROR(insert.Bind(1, first).BindBlob(2, tasks).Run());
  RG_ASSIGN_OR_RETURN(auto outputs,
                      db_->Prepare("INSERT OR IGNORE INTO archived_outputs (job, sha256) SELECT ?1, sha256 "
                                   "FROM outputs WHERE task BETWEEN ?2 AND ?3"));
  RG_RETURN_IF_ERROR(outputs.Bind(1, JobOf(first)).Bind(2, first).Bind(3, last).Run());
  RG_ASSIGN_OR_RETURN(
      auto token, db_->Prepare("SELECT COALESCE(MAX(token), 0) FROM attempts WHERE task BETWEEN ? AND ?"));
  token.Bind(1, first).Bind(2, last);
  RG_ASSIGN_OR_RETURN(const bool has_row, token.Step());
  RG_ASSIGN_OR_RETURN(auto mark, db_->Prepare(kMark));
  RG_RETURN_IF_ERROR(mark.Bind(1, "token").Bind(2, has_row ? token.Int(0) : 0).Run());
  token.Reset();
  for (const char* drop :
       {"DELETE FROM tasks WHERE id BETWEEN ? AND ?", "DELETE FROM task_specs WHERE task BETWEEN ? AND ?",
        "DELETE FROM attempts WHERE task BETWEEN ? AND ?", "DELETE FROM results WHERE task BETWEEN ? AND ?",
        "DELETE FROM outputs WHERE task BETWEEN ? AND ?",
        "DELETE FROM checkpoints WHERE task BETWEEN ? AND ?",
        "DELETE FROM task_logs WHERE task BETWEEN ? AND ?"}) {
    RG_ASSIGN_OR_RETURN(auto statement, db_->Prepare(drop));
    RG_RETURN_IF_ERROR(statement.Bind(1, first).Bind(2, last).Run());
  }
  RG_ASSIGN_OR_RETURN(auto next, db_->Prepare("UPDATE archived_jobs SET next_task=? WHERE job=?"));
  return next.Bind(1, static_cast<int64_t>(IndexOf(last)) + 1).Bind(2, JobOf(first)).Run();
}

Status JobStore::EndArchive(JobId job, int64_t wall_ns) {
  RG_ASSIGN_OR_RETURN(auto events, db_->Prepare("DELETE FROM events WHERE job=?"));
  RG_RETURN_IF_ERROR(events.Bind(1, job).Run());
  RG_ASSIGN_OR_RETURN(auto done, db_->Prepare("UPDATE jobs SET archived_ns=? WHERE id=?"));
  return done.Bind(1, wall_ns).Bind(2, job).Run();
}

Result<JobId> JobStore::NextToArchive(int64_t before_ns, int64_t max_tasks) {
  RG_ASSIGN_OR_RETURN(auto first, db_->Prepare("SELECT id, finished_ns FROM jobs WHERE finished_ns > 0 AND "
                                               "archived_ns = 0 ORDER BY finished_ns LIMIT 1"));
  RG_ASSIGN_OR_RETURN(const bool found, first.Step());
  if (!found) return JobId{0};
  if (first.Int(1) < before_ns) return first.Int(0);
  if (max_tasks == 0) return JobId{0};
  RG_ASSIGN_OR_RETURN(auto sum, db_->Prepare("SELECT COALESCE(SUM(tasks_total), 0) FROM jobs WHERE "
                                             "finished_ns > 0 AND archived_ns = 0"));
  RG_ASSIGN_OR_RETURN(const bool has_row, sum.Step());
  return has_row && sum.Int(0) > max_tasks ? first.Int(0) : JobId{0};
}

Result<int64_t> JobStore::OldestEvent() {
  RG_ASSIGN_OR_RETURN(auto row, db_->Prepare("SELECT wall_ns FROM events WHERE job = 0 ORDER BY id LIMIT 1"));
  RG_ASSIGN_OR_RETURN(const bool found, row.Step());
  return found ? row.Int(0) : 0;
}

Result<int> JobStore::DropOldEvents(int64_t before_ns, int limit) {
  RG_ASSIGN_OR_RETURN(auto drop,
                      db_->Prepare("DELETE FROM events WHERE id IN (SELECT id FROM (SELECT id, wall_ns FROM "
                                   "events WHERE job = 0 ORDER BY id LIMIT ?2) WHERE wall_ns < ?1)"));
  drop.Bind(1, before_ns).Bind(2, limit);
  RG_RETURN_IF_ERROR(drop.Run());
  return db_->changes();
}

}  // namespace rg::coordinator
