#include "coordinator/store/job_store.h"

#include <nlohmann/json.hpp>

#include "realitygrad/v1/job.pb.h"

namespace rg::coordinator {
namespace {

using Json = nlohmann::json;

std::string JoinLines(const std::vector<std::string>& items) {
  std::string text;
  for (const std::string& item : items) text += item + '\n';
  return text;
}

std::string PackParents(const std::vector<ParentEdge>& parents) {
  std::string bytes;
  for (const ParentEdge& edge : parents) {
    const uint32_t code = edge.parent * 2 + (edge.optional ? 1 : 0);
    for (int shift = 0; shift < 32; shift += 8) bytes.push_back(static_cast<char>((code >> shift) & 0xff));
  }
  return bytes;
}

}  // namespace

Status JobStore::Apply(const std::vector<Row>& rows, const ResultsByToken& results) {
  results_ = &results;
  for (const Row& row : rows) {
    const Status status = std::visit([this](const auto& r) { return ApplyOne(r); }, row);
    if (!status.ok()) return status.WithPrefix("coordinator database");
  }
  return Status::Ok();
}

Status JobStore::ApplyOne(const InsertJob& row) {
  RG_ASSIGN_OR_RETURN(auto insert,
                      db_->Prepare("INSERT INTO jobs (id, request_id, kind, name, submitted_by, spec_json, "
                                   "priority, tags_json, labels_json, phase, submitted_ns, parent, content, "
                                   "inputs_listed, tasks_total, time_limit_ns, after_json) VALUES "
                                   "(?,?,?,?,?,?,?,?,?,?,?,?,?,1,?,?,?)"));
  const JobPlan& plan = *row.plan;
  insert.Bind(1, row.job)
      .Bind(2, row.request_id)
      .Bind(3, plan.kind)
      .Bind(4, plan.name)
      .Bind(5, plan.submitted_by);
  insert.Bind(6, plan.spec_json)
      .Bind(7, plan.priority)
      .Bind(8, Json(plan.tags).dump())
      .Bind(9, Json(plan.labels).dump());
  insert.Bind(10, static_cast<int>(JobPhase::kQueued)).Bind(11, row.submitted_ns).Bind(12, plan.parent);
  insert.Bind(13, plan.content).Bind(14, static_cast<int64_t>(plan.tasks.size()));
  insert.Bind(15, plan.time_limit_ns).Bind(16, Json(plan.after_jobs).dump());
  RG_RETURN_IF_ERROR(insert.Run());
  for (uint32_t i = 0; i < plan.tasks.size(); ++i) {
    const TaskId id = MakeTaskId(row.job, i);
    RG_RETURN_IF_ERROR(InsertTask(id, plan.tasks[i]));
    if (row.specs == nullptr) continue;
    RG_RETURN_IF_ERROR(InsertInputs(row.job, (*row.specs)[i]));
    RG_ASSIGN_OR_RETURN(auto spec, db_->Prepare("INSERT INTO task_specs (task, spec) VALUES (?,?)"));
    RG_RETURN_IF_ERROR(spec.Bind(1, id).BindBlob(2, (*row.specs)[i]).Run());
  }
  return Status::Ok();
}

Status JobStore::InsertInputs(JobId job, std::string_view spec) {
  realitygrad::v1::TaskSpec task;
  if (!task.ParseFromArray(spec.data(), static_cast<int>(spec.size())))
    return DataLossError("job " + std::to_string(job) + ": a task's specification does not parse");
  for (const auto& input : task.inputs()) {
    if (!input.has_artifact()) continue;
    RG_ASSIGN_OR_RETURN(auto insert, db_->Prepare("INSERT OR IGNORE INTO job_inputs VALUES (?,?)"));
    RG_RETURN_IF_ERROR(insert.Bind(1, job).Bind(2, input.artifact()).Run());
  }
  return Status::Ok();
}

Status JobStore::ListMissingInputs() {
  std::vector<JobId> jobs;
  {
    RG_ASSIGN_OR_RETURN(auto rows, db_->Prepare("SELECT id FROM jobs WHERE inputs_listed=0 ORDER BY id"));
    while (true) {
      RG_ASSIGN_OR_RETURN(const bool more, rows.Step());
      if (!more) break;
      jobs.push_back(rows.Int(0));
    }
  }
  for (const JobId job : jobs) {
    RG_RETURN_IF_ERROR(db_->InTransaction([&]() -> Status {
      RG_ASSIGN_OR_RETURN(auto rows, db_->Prepare("SELECT spec FROM task_specs WHERE task BETWEEN ? AND ?"));
      rows.Bind(1, MakeTaskId(job, 0)).Bind(2, MakeTaskId(job, kMaxTasksPerJob - 1));
      while (true) {
        RG_ASSIGN_OR_RETURN(const bool more, rows.Step());
        if (!more) break;
        RG_RETURN_IF_ERROR(InsertInputs(job, rows.Blob(0)));
      }
      RG_ASSIGN_OR_RETURN(auto done, db_->Prepare("UPDATE jobs SET inputs_listed=1 WHERE id=?"));
      return done.Bind(1, job).Run();
    }));
  }
  return Status::Ok();
}

std::vector<std::string> JobStore::ArtifactReferences(int64_t ended_before_ns) {
  const std::string counts = "(finished_ns = 0 OR finished_ns >= " + std::to_string(ended_before_ns) + ")";
  const std::string jobs = "(SELECT id FROM jobs WHERE " + counts + ")";
  const std::string index_bits = std::to_string(kTaskIndexBits);
  return {"SELECT sha256 FROM job_inputs WHERE job IN " + jobs,
          "SELECT sha256 FROM outputs WHERE (task >> " + index_bits + ") IN " + jobs,
          "SELECT sha256 FROM archived_outputs WHERE job IN " + jobs,
          "SELECT a2.sha256 FROM artifact a2 JOIN artifact_producer p ON p.artifact = a2.id JOIN jobs j ON "
          "j.id = CAST(p.job_id AS INTEGER) WHERE j.finished_ns = 0"};
}

Status JobStore::InsertTask(TaskId id, const TaskPlan& plan) {
  RG_ASSIGN_OR_RETURN(
      auto insert,
      db_->Prepare("INSERT INTO tasks (id, name, stage, kind, tags, parents, priority, max_attempts, "
                   "crash_limit, at_most_once, weight, phase) VALUES (?,?,?,?,?,?,?,?,?,?,?,?)"));
  const std::string parents = PackParents(plan.parents);
  insert.Bind(1, id)
      .Bind(2, plan.name)
      .Bind(3, plan.stage)
      .Bind(4, plan.kind)
      .Bind(5, JoinLines(plan.required_tags));
  insert.BindBlob(6, parents).Bind(7, plan.priority).Bind(8, static_cast<int64_t>(plan.max_attempts));
  insert.Bind(9, static_cast<int64_t>(plan.crash_limit))
      .Bind(10, plan.at_most_once ? 1 : 0)
      .Bind(11, plan.weight);
  insert.Bind(12, static_cast<int>(TaskPhase::kWaiting));
  return insert.Run();
}

Status JobStore::ApplyOne(const UpdateJob& row) {
  RG_ASSIGN_OR_RETURN(auto update,
                      db_->Prepare("UPDATE jobs SET phase=?, reason=?, started_ns=?, finished_ns=?, "
                                   "tasks_succeeded=?, tasks_failed=?, progress=?, priority_shift=?, deadline_ns=? "
                                   "WHERE id=?"));
  update.Bind(1, static_cast<int>(row.record.phase))
      .Bind(2, row.record.reason)
      .Bind(3, row.record.started_ns);
  update.Bind(4, row.record.finished_ns).Bind(5, static_cast<int64_t>(row.counts.succeeded));
  update.Bind(6, static_cast<int64_t>(row.counts.failed)).Bind(7, row.counts.progress);
  update.Bind(8, row.record.priority_shift).Bind(9, row.record.deadline_ns).Bind(10, row.job);
  RG_RETURN_IF_ERROR(update.Run());
  if (row.record.phase != JobPhase::kCancelled) return Status::Ok();
  RG_ASSIGN_OR_RETURN(auto forget, db_->Prepare("DELETE FROM checkpoints WHERE task BETWEEN ? AND ?"));
  return forget.Bind(1, MakeTaskId(row.job, 0)).Bind(2, MakeTaskId(row.job, kMaxTasksPerJob - 1)).Run();
}

Status JobStore::ApplyOne(const UpdateTask& row) {
  RG_ASSIGN_OR_RETURN(
      auto update,
      db_->Prepare("UPDATE tasks SET phase=?1, attempts=?2, failures=?3, crashes=?4, losses=?5, token=?6, "
                   "set_aside=?7, reason=?8, "
                   "started_ns=CASE WHEN ?1=3 AND started_ns=0 THEN ?9 ELSE started_ns END, "
                   "finished_ns=CASE WHEN ?1 IN (4,5,6) THEN ?9 ELSE 0 END WHERE id=?10"));
  const TaskRecord& r = row.record;
  update.Bind(1, static_cast<int>(r.phase)).Bind(2, static_cast<int64_t>(r.attempts));
  update.Bind(3, static_cast<int64_t>(r.failures)).Bind(4, static_cast<int64_t>(r.crashes));
  update.Bind(5, static_cast<int64_t>(r.losses))
      .Bind(6, static_cast<int64_t>(r.token))
      .Bind(7, r.set_aside ? 1 : 0);
  return update.Bind(8, row.reason).Bind(9, row.wall_ns).Bind(10, row.task).Run();
}

Status JobStore::ApplyOne(const InsertAttempt& row) {
  RG_ASSIGN_OR_RETURN(
      auto insert,
      db_->Prepare("INSERT INTO attempts (token, task, number, worker, instance, leased_ns, key) "
                   "VALUES (?,?,?,?,?,?,?)"));
  insert.Bind(1, static_cast<int64_t>(row.token)).Bind(2, row.task).Bind(3, static_cast<int64_t>(row.number));
  return insert.Bind(4, row.worker).Bind(5, row.instance).Bind(6, row.wall_ns).Bind(7, row.key).Run();
}

Status JobStore::ApplyOne(const GrantAttempt& row) {
  RG_ASSIGN_OR_RETURN(auto update, db_->Prepare("UPDATE attempts SET granted_ns=? WHERE token=?"));
  return update.Bind(1, row.wall_ns).Bind(2, static_cast<int64_t>(row.token)).Run();
}

Status JobStore::ApplyOne(const FinishAttempt& row) {
  RG_ASSIGN_OR_RETURN(
      auto update,
      db_->Prepare("UPDATE attempts SET outcome=?, error=?, finished_ns=? WHERE token=? AND outcome=0"));
  update.Bind(1, static_cast<int>(row.outcome)).Bind(2, row.error).Bind(3, row.wall_ns);
  return update.Bind(4, static_cast<int64_t>(row.token)).Run();
}

Status JobStore::ApplyOne(const CommitResult& row) {
  const auto found = results_->find(row.token);
  if (found == results_->end())
    return InternalError("result of lease " + std::to_string(row.token) + " is not at hand");
  const ResultRow& result = found->second;
  RG_ASSIGN_OR_RETURN(
      auto insert, db_->Prepare("INSERT INTO results (task, token, summary_json, seconds) VALUES (?,?,?,?)"));
  insert.Bind(1, row.task)
      .Bind(2, static_cast<int64_t>(row.token))
      .Bind(3, result.summary_json)
      .Bind(4, result.seconds);
  RG_RETURN_IF_ERROR(insert.Run());
  for (size_t i = 0; i < result.outputs.size(); ++i) {
    const OutputRow& output = result.outputs[i];
    RG_ASSIGN_OR_RETURN(
        auto out,
        db_->Prepare("INSERT INTO outputs (task, position, name, kind, sha256, size, metadata_json) "
                     "VALUES (?,?,?,?,?,?,?)"));
    out.Bind(1, row.task).Bind(2, static_cast<int64_t>(i)).Bind(3, output.name).Bind(4, output.kind);
    out.Bind(5, output.sha256).Bind(6, output.size).Bind(7, output.metadata_json);
    RG_RETURN_IF_ERROR(out.Run());
  }
  RG_ASSIGN_OR_RETURN(auto forget, db_->Prepare("DELETE FROM checkpoints WHERE task=?"));
  return forget.Bind(1, row.task).Run();
}

Status JobStore::ApplyOne(const CloseTasks& row) {
  const TaskId first = MakeTaskId(row.job, 0), last = MakeTaskId(row.job, kMaxTasksPerJob - 1);
  RG_ASSIGN_OR_RETURN(auto tasks,
                      db_->Prepare("UPDATE tasks SET phase=6, token=0, set_aside=0, reason=?, finished_ns=? "
                                   "WHERE id BETWEEN ? AND ? AND phase IN (1,2,3,7)"));
  RG_RETURN_IF_ERROR(tasks.Bind(1, row.reason).Bind(2, row.wall_ns).Bind(3, first).Bind(4, last).Run());
  RG_ASSIGN_OR_RETURN(auto attempts, db_->Prepare("UPDATE attempts SET outcome=6, error=?, finished_ns=? "
                                                  "WHERE outcome=0 AND task BETWEEN ? AND ?"));
  return attempts.Bind(1, row.reason).Bind(2, row.wall_ns).Bind(3, first).Bind(4, last).Run();
}

Status JobStore::ApplyOne(const ReopenTasks& row) {
  RG_ASSIGN_OR_RETURN(auto update,
                      db_->Prepare("UPDATE tasks SET phase=1, failures=0, crashes=0, losses=0, token=0, "
                                   "set_aside=0, reason='', finished_ns=0 "
                                   "WHERE id BETWEEN ? AND ? AND phase<>4"));
  return update.Bind(1, MakeTaskId(row.job, 0)).Bind(2, MakeTaskId(row.job, kMaxTasksPerJob - 1)).Run();
}

Status JobStore::ApplyOne(const SetHold& row) {
  if (row.released) {
    RG_ASSIGN_OR_RETURN(auto remove, db_->Prepare("DELETE FROM robot_holds WHERE robot=?"));
    return remove.Bind(1, row.robot).Run();
  }
  RG_ASSIGN_OR_RETURN(auto insert, db_->Prepare("INSERT OR REPLACE INTO robot_holds (robot, reason, held_by, since_ns) "
                                                "VALUES (?,?,?,?)"));
  return insert.Bind(1, row.robot).Bind(2, row.hold.reason).Bind(3, row.hold.by).Bind(4, row.hold.since_ns).Run();
}

Status JobStore::ApplyOne(const AppendEvent& row) {
  RG_ASSIGN_OR_RETURN(
      auto insert,
      db_->Prepare("INSERT INTO events (wall_ns, job, task, worker, kind, detail) VALUES (?,?,?,?,?,?)"));
  insert.Bind(1, row.wall_ns).Bind(2, row.job).Bind(3, row.task).Bind(4, row.worker).Bind(5, row.kind);
  return insert.Bind(6, row.detail).Run();
}

Status JobStore::SaveCheckpoint(TaskId task, Token token, uint64_t sequence, std::string_view bytes) {
  RG_ASSIGN_OR_RETURN(
      auto upsert,
      db_->Prepare("INSERT INTO checkpoints (task, token, sequence, bytes) VALUES (?,?,?,?) "
                   "ON CONFLICT (task) DO UPDATE SET token=excluded.token, sequence=excluded.sequence, "
                   "bytes=excluded.bytes WHERE excluded.token > token OR "
                   "(excluded.token = token AND excluded.sequence > sequence)"));
  upsert.Bind(1, task).Bind(2, static_cast<int64_t>(token)).Bind(3, static_cast<int64_t>(sequence));
  return upsert.BindBlob(4, bytes).Run();
}

Status JobStore::AppendLog(const LogRow& row) {
  RG_ASSIGN_OR_RETURN(auto insert,
                      db_->Prepare("INSERT INTO task_logs (task, attempt, wall_ns, text) VALUES (?,?,?,?)"));
  insert.Bind(1, row.task).Bind(2, static_cast<int64_t>(row.attempt)).Bind(3, row.wall_ns).Bind(4, row.text);
  RG_RETURN_IF_ERROR(insert.Run());
  constexpr int kTrimEvery = 500;
  if (++log_lines_[row.task] % kTrimEvery == 0) return TrimLog(row.task);
  return Status::Ok();
}

Status JobStore::ProbeRoom(int64_t bytes) {
  constexpr TaskId kNoTask = -1;
  RG_RETURN_IF_ERROR(db_->InTransaction([&]() -> Status {
    RG_ASSIGN_OR_RETURN(auto fill, db_->Prepare("INSERT OR REPLACE INTO checkpoints (task, token, sequence, "
                                                "bytes) VALUES (?, 0, 0, zeroblob(?))"));
    return fill.Bind(1, kNoTask).Bind(2, bytes).Run();
  }));
  return db_->InTransaction([&]() -> Status {
    RG_ASSIGN_OR_RETURN(auto clear, db_->Prepare("DELETE FROM checkpoints WHERE task = ?"));
    return clear.Bind(1, kNoTask).Run();
  });
}

void JobStore::ForgetLogCounts(JobId job) {
  log_lines_.erase(log_lines_.lower_bound(MakeTaskId(job, 0)),
                   log_lines_.upper_bound(MakeTaskId(job, kMaxTasksPerJob - 1)));
}

Status JobStore::TrimLog(TaskId task) {
  RG_ASSIGN_OR_RETURN(
      auto trim, db_->Prepare("DELETE FROM task_logs WHERE task=?1 AND sequence <= (SELECT sequence FROM "
                              "task_logs WHERE task=?1 ORDER BY sequence DESC LIMIT 1 OFFSET ?2)"));
  return trim.Bind(1, task).Bind(2, kMaxLogLines).Run();
}

}  // namespace rg::coordinator
