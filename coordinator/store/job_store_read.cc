// The reading half of JobStore.
#include <nlohmann/json.hpp>

#include "coordinator/store/job_store.h"

namespace rg::coordinator {
namespace {

using Json = nlohmann::json;

std::vector<std::string> SplitLines(const std::string& text) {
  std::vector<std::string> items;
  for (size_t begin = 0; begin < text.size();) {
    const size_t end = text.find('\n', begin);
    items.push_back(text.substr(begin, end - begin));
    if (end == std::string::npos) break;
    begin = end + 1;
  }
  return items;
}

Result<std::vector<ParentEdge>> UnpackParents(std::string_view bytes, uint32_t task_count) {
  std::vector<ParentEdge> parents;
  if (bytes.size() % 4 != 0) return DataLossError("list of parents is truncated");
  for (size_t i = 0; i < bytes.size(); i += 4) {
    uint32_t code = 0;
    for (size_t b = 0; b < 4; ++b) code |= uint32_t{static_cast<unsigned char>(bytes[i + b])} << (8 * b);
    if (code / 2 >= task_count)
      return DataLossError("parent " + std::to_string(code / 2) + " does not exist");
    parents.push_back({code / 2, code % 2 == 1});
  }
  return parents;
}

}  // namespace

Result<StoredState> JobStore::Load() {
  StoredState out;
  std::vector<std::shared_ptr<JobPlan>> plans;
  RG_RETURN_IF_ERROR(LoadJobs(&out, &plans));
  RG_RETURN_IF_ERROR(LoadTasks(&out, plans));
  RG_RETURN_IF_ERROR(LoadOpenAttempts(&out));
  return out;
}

Status JobStore::LoadJobs(StoredState* out, std::vector<std::shared_ptr<JobPlan>>* plans) {
  RG_ASSIGN_OR_RETURN(
      auto rows,
      db_->Prepare("SELECT id, request_id, kind, name, submitted_by, spec_json, priority, tags_json, "
                   "labels_json, phase, reason, submitted_ns, started_ns, finished_ns, parent, content "
                   "FROM jobs ORDER BY id"));
  while (true) {
    RG_ASSIGN_OR_RETURN(const bool more, rows.Step());
    if (!more) return Status::Ok();
    StoredJob& job = out->jobs.emplace_back();
    job.job = rows.Int(0);
    job.request_id = rows.Text(1);
    auto plan = std::make_shared<JobPlan>();
    plan->kind = rows.Text(2);
    plan->name = rows.Text(3);
    plan->submitted_by = rows.Text(4);
    plan->spec_json = rows.Text(5);
    plan->priority = static_cast<int32_t>(rows.Int(6));
    const Json tags = Json::parse(rows.Text(7), nullptr, false),
               labels = Json::parse(rows.Text(8), nullptr, false);
    if (!tags.is_array() || !labels.is_object()) {
      return DataLossError("job " + std::to_string(job.job) + ": tags or labels do not parse");
    }
    plan->tags = tags.get<std::vector<std::string>>();
    plan->labels = labels.get<std::map<std::string, std::string>>();
    job.record = {static_cast<JobPhase>(rows.Int(9)), rows.Text(10), rows.Int(11), rows.Int(12),
                  rows.Int(13)};
    plan->parent = rows.Int(14);
    plan->content = rows.Text(15);
    if (plan->parent < 0 || JobOf(plan->parent) >= job.job)
      return DataLossError("job " + std::to_string(job.job) + ": submitted by a task of a later job");
    job.plan = plan;
    plans->push_back(std::move(plan));
  }
}

Status JobStore::LoadTasks(StoredState* out, const std::vector<std::shared_ptr<JobPlan>>& plans) {
  std::unordered_map<JobId, size_t> positions;
  for (size_t j = 0; j < out->jobs.size(); ++j) positions[out->jobs[j].job] = j;
  RG_ASSIGN_OR_RETURN(auto counts, db_->Prepare("SELECT COUNT(*) FROM tasks WHERE id BETWEEN ? AND ?"));
  for (size_t j = 0; j < out->jobs.size(); ++j) {
    StoredJob& job = out->jobs[j];
    counts.Bind(1, MakeTaskId(job.job, 0)).Bind(2, MakeTaskId(job.job, kMaxTasksPerJob - 1));
    RG_ASSIGN_OR_RETURN(const bool has_row, counts.Step());
    const auto count = static_cast<size_t>(has_row ? counts.Int(0) : 0);
    counts.Reset();
    job.tasks.resize(count);
    plans[j]->tasks.resize(count);
  }
  RG_ASSIGN_OR_RETURN(
      auto rows, db_->Prepare("SELECT id, name, stage, kind, tags, parents, priority, max_attempts, "
                              "crash_limit, at_most_once, weight, phase, attempts, failures, crashes, "
                              "losses, token, set_aside, started_ns, finished_ns FROM tasks ORDER BY id"));
  while (true) {
    RG_ASSIGN_OR_RETURN(const bool more, rows.Step());
    if (!more) return Status::Ok();
    const TaskId id = rows.Int(0);
    const auto found = positions.find(JobOf(id));
    if (found == positions.end() || IndexOf(id) >= out->jobs[found->second].tasks.size()) {
      return DataLossError("task " + std::to_string(id) + " belongs to no job");
    }
    StoredJob& job = out->jobs[found->second];
    TaskPlan& plan = plans[found->second]->tasks[IndexOf(id)];
    plan.name = rows.Text(1);
    plan.stage = rows.Text(2);
    plan.kind = rows.Text(3);
    plan.required_tags = SplitLines(rows.Text(4));
    auto parents = UnpackParents(rows.Blob(5), static_cast<uint32_t>(job.tasks.size()));
    if (!parents.ok()) return parents.status().WithPrefix("task " + std::to_string(id));
    plan.parents = *std::move(parents);
    plan.priority = static_cast<int32_t>(rows.Int(6));
    plan.max_attempts = static_cast<uint32_t>(rows.Int(7));
    plan.crash_limit = static_cast<uint32_t>(rows.Int(8));
    plan.at_most_once = rows.Int(9) != 0;
    plan.weight = rows.Real(10);
    TaskRecord& record = job.tasks[IndexOf(id)];
    record.phase = static_cast<TaskPhase>(rows.Int(11));
    record.attempts = static_cast<uint32_t>(rows.Int(12));
    record.failures = static_cast<uint32_t>(rows.Int(13));
    record.crashes = static_cast<uint32_t>(rows.Int(14));
    record.losses = static_cast<uint32_t>(rows.Int(15));
    record.token = static_cast<Token>(rows.Int(16));
    record.set_aside = rows.Int(17) != 0;
    record.started_ns = rows.Int(18);
    record.finished_ns = rows.Int(19);
  }
}

Status JobStore::LoadOpenAttempts(StoredState* out) {
  RG_ASSIGN_OR_RETURN(auto last, db_->Prepare("SELECT COALESCE(MAX(token), 0) FROM attempts"));
  RG_ASSIGN_OR_RETURN(const bool has_row, last.Step());
  if (has_row) out->last_token = static_cast<Token>(last.Int(0));
  RG_ASSIGN_OR_RETURN(
      auto rows, db_->Prepare("SELECT task, token, number, worker, instance, key, granted_ns FROM attempts "
                              "WHERE outcome=0 ORDER BY token"));
  while (true) {
    RG_ASSIGN_OR_RETURN(const bool more, rows.Step());
    if (!more) return Status::Ok();
    out->open_attempts.push_back({rows.Int(0), static_cast<Token>(rows.Int(1)),
                                  static_cast<uint32_t>(rows.Int(2)), rows.Text(3), rows.Text(4),
                                  rows.Text(5), rows.Int(6) != 0});
  }
}

Result<std::string> JobStore::Spec(TaskId task) {
  RG_ASSIGN_OR_RETURN(auto row, db_->Prepare("SELECT spec FROM task_specs WHERE task=?"));
  row.Bind(1, task);
  RG_ASSIGN_OR_RETURN(const bool found, row.Step());
  if (!found) return NotFoundError("task " + std::to_string(task) + " has no specification");
  return std::string(row.Blob(0));
}

Result<std::vector<OutputRow>> JobStore::Outputs(TaskId task) {
  RG_ASSIGN_OR_RETURN(auto rows,
                      db_->Prepare("SELECT name, kind, sha256, size, metadata_json FROM outputs WHERE task=? "
                                   "ORDER BY position"));
  rows.Bind(1, task);
  std::vector<OutputRow> outputs;
  while (true) {
    RG_ASSIGN_OR_RETURN(const bool more, rows.Step());
    if (!more) return outputs;
    OutputRow& output = outputs.emplace_back();
    output.name = rows.Text(0);
    output.kind = rows.Text(1);
    output.sha256 = rows.Text(2);
    output.size = rows.Int(3);
    output.metadata_json = rows.Text(4);
  }
}

Result<TaskRows> JobStore::ReadTasks(TaskId first, TaskId last, bool with_attempts) {
  TaskRows out;
  const auto each = [&](std::string_view sql, const auto& take) -> Status {
    RG_ASSIGN_OR_RETURN(auto rows, db_->Prepare(sql));
    rows.Bind(1, first).Bind(2, last);
    while (true) {
      RG_ASSIGN_OR_RETURN(const bool more, rows.Step());
      if (!more) return Status::Ok();
      take(rows);
    }
  };
  RG_RETURN_IF_ERROR(
      each("SELECT tasks.id, reason, started_ns, finished_ns, COALESCE(summary_json, '') FROM tasks "
           "LEFT JOIN results ON results.task = tasks.id WHERE tasks.id BETWEEN ? AND ?",
           [&](const store::Statement& row) {
             out.details[row.Int(0)] = {row.Text(1), row.Int(2), row.Int(3), row.Text(4)};
           }));
  RG_RETURN_IF_ERROR(
      each("SELECT task, name, kind, sha256, metadata_json, size FROM outputs "
           "WHERE task BETWEEN ? AND ? ORDER BY task, position",
           [&](const store::Statement& row) {
             out.outputs.emplace(row.Int(0),
                                 OutputRow{row.Text(1), row.Text(2), row.Text(3), row.Text(4), row.Int(5)});
           }));
  if (!with_attempts) return out;
  RG_RETURN_IF_ERROR(
      each("SELECT task, number, token, worker, error, leased_ns, finished_ns, outcome FROM attempts "
           "WHERE task BETWEEN ? AND ? ORDER BY task, token",
           [&](const store::Statement& row) {
             out.attempts.emplace(
                 row.Int(0),
                 AttemptRow{static_cast<uint32_t>(row.Int(1)), static_cast<Token>(row.Int(2)), row.Text(3),
                            row.Text(4), row.Int(5), row.Int(6), static_cast<Outcome>(row.Int(7))});
           }));
  return out;
}

Result<std::string> JobStore::Checkpoint(TaskId task) {
  RG_ASSIGN_OR_RETURN(auto row, db_->Prepare("SELECT bytes FROM checkpoints WHERE task=?"));
  row.Bind(1, task);
  RG_ASSIGN_OR_RETURN(const bool found, row.Step());
  return found ? std::string(row.Blob(0)) : std::string();
}

Result<TaskId> JobStore::FindTask(JobId job, const std::string& name) {
  RG_ASSIGN_OR_RETURN(auto row, db_->Prepare("SELECT id FROM tasks WHERE id BETWEEN ? AND ? AND name = ?"));
  row.Bind(1, MakeTaskId(job, 0)).Bind(2, MakeTaskId(job, kMaxTasksPerJob - 1)).Bind(3, name);
  RG_ASSIGN_OR_RETURN(const bool found, row.Step());
  if (!found) return NotFoundError("job " + std::to_string(job) + " has no task '" + name + "'");
  return row.Int(0);
}

Result<std::vector<LogRow>> JobStore::Logs(TaskId first, TaskId last, uint64_t after_sequence, int limit) {
  // One task: by its index. A whole job: by sequence, which is the order people read in.
  RG_ASSIGN_OR_RETURN(
      auto rows,
      db_->Prepare("SELECT l.task, l.attempt, l.wall_ns, l.sequence, l.text, coalesce(t.name, '') FROM "
                   "task_logs l LEFT JOIN tasks t ON t.id = l.task WHERE l.task BETWEEN ? AND ? "
                   "AND l.sequence > ? ORDER BY l.sequence LIMIT ?"));
  rows.Bind(1, first).Bind(2, last).Bind(3, static_cast<int64_t>(after_sequence)).Bind(4, limit);
  std::vector<LogRow> lines;
  while (true) {
    RG_ASSIGN_OR_RETURN(const bool more, rows.Step());
    if (!more) return lines;
    lines.push_back({rows.Int(0), static_cast<uint32_t>(rows.Int(1)), rows.Int(2),
                     static_cast<uint64_t>(rows.Int(3)), rows.Text(4), rows.Text(5)});
  }
}

Result<std::vector<EventRow>> JobStore::Events(JobId job, int64_t after_id, int limit) {
  RG_ASSIGN_OR_RETURN(
      auto rows, db_->Prepare(job == 0 ? "SELECT id, wall_ns, job, task, worker, kind, detail FROM events "
                                         "WHERE ?1=0 AND id > ?2 ORDER BY id LIMIT ?3"
                                       : "SELECT id, wall_ns, job, task, worker, kind, detail FROM events "
                                         "WHERE job=?1 AND id > ?2 ORDER BY id LIMIT ?3"));
  rows.Bind(1, job).Bind(2, after_id).Bind(3, limit);
  std::vector<EventRow> events;
  while (true) {
    RG_ASSIGN_OR_RETURN(const bool more, rows.Step());
    if (!more) return events;
    events.push_back(
        {rows.Int(0), {rows.Int(1), rows.Int(2), rows.Text(3), rows.Text(4), rows.Text(5), rows.Text(6)}});
  }
}

}  // namespace rg::coordinator
