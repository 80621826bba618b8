// The reading half of JobStore.
#include <algorithm>
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

constexpr std::string_view kTaskColumns =
    "SELECT id, name, stage, kind, tags, parents, priority, max_attempts, crash_limit, at_most_once, weight, "
    "phase, attempts, failures, crashes, losses, token, set_aside, started_ns, finished_ns FROM tasks "
    "WHERE id BETWEEN ? AND ? ORDER BY id";

Status TakeTask(const store::Statement& row, uint32_t count, TaskPlan* plan, TaskRecord* record) {
  plan->name = row.Text(1);
  plan->stage = row.Text(2);
  plan->kind = row.Text(3);
  plan->required_tags = SplitLines(row.Text(4));
  auto parents = UnpackParents(row.Blob(5), count);
  if (!parents.ok()) return parents.status().WithPrefix("task " + std::to_string(row.Int(0)));
  plan->parents = *std::move(parents);
  plan->priority = static_cast<int32_t>(row.Int(6));
  plan->max_attempts = static_cast<uint32_t>(row.Int(7));
  plan->crash_limit = static_cast<uint32_t>(row.Int(8));
  plan->at_most_once = row.Int(9) != 0;
  plan->weight = row.Real(10);
  record->phase = static_cast<TaskPhase>(row.Int(11));
  record->attempts = static_cast<uint32_t>(row.Int(12));
  record->failures = static_cast<uint32_t>(row.Int(13));
  record->crashes = static_cast<uint32_t>(row.Int(14));
  record->losses = static_cast<uint32_t>(row.Int(15));
  record->token = static_cast<Token>(row.Int(16));
  record->set_aside = row.Int(17) != 0;
  record->started_ns = row.Int(18);
  record->finished_ns = row.Int(19);
  return Status::Ok();
}

}  // namespace

Result<StoredState> JobStore::Load() {
  StoredState out;
  std::vector<std::shared_ptr<JobPlan>> plans;
  RG_RETURN_IF_ERROR(ReadJobs("WHERE phase IN (1, 2, 3) ORDER BY id", {}, [&](JobRow row) {
    auto plan = std::make_shared<JobPlan>(*row.plan);
    out.jobs.push_back({row.job, row.request_id, row.record, plan, {}});
    plans.push_back(std::move(plan));
    return true;
  }));
  for (size_t j = 0; j < plans.size(); ++j) RG_RETURN_IF_ERROR(LoadTasks(&out.jobs[j], plans[j].get()));
  RG_RETURN_IF_ERROR(LoadOpenAttempts(&out));
  RG_RETURN_IF_ERROR(LoadHighWater(&out));
  RG_RETURN_IF_ERROR(LoadHolds(&out));
  return out;
}

Result<StoredJob> JobStore::LoadJob(JobId job, bool with_tasks) {
  RG_ASSIGN_OR_RETURN(const JobRow row, FindJob(job));
  auto plan = std::make_shared<JobPlan>(*row.plan);
  StoredJob out{row.job, row.request_id, row.record, plan, {}};
  if (with_tasks) RG_RETURN_IF_ERROR(LoadTasks(&out, plan.get()));
  return out;
}

Status JobStore::ReadJobs(std::string_view where, const std::function<void(store::Statement&)>& bind,
                          const std::function<bool(JobRow)>& take) {
  RG_ASSIGN_OR_RETURN(
      auto rows, db_->Prepare("SELECT id, request_id, kind, name, submitted_by, spec_json, priority, "
                              "tags_json, labels_json, phase, reason, submitted_ns, started_ns, finished_ns, "
                              "parent, content, tasks_total, tasks_succeeded, tasks_failed, progress, "
                              "archived_ns, priority_shift, time_limit_ns, deadline_ns, after_json FROM jobs " +
                              std::string(where)));
  if (bind) bind(rows);
  while (true) {
    RG_ASSIGN_OR_RETURN(const bool more, rows.Step());
    if (!more) return Status::Ok();
    JobRow job;
    job.job = rows.Int(0);
    job.request_id = rows.Text(1);
    auto plan = std::make_shared<JobPlan>();
    plan->kind = rows.Text(2);
    plan->name = rows.Text(3);
    plan->submitted_by = rows.Text(4);
    plan->spec_json = rows.Text(5);
    plan->priority = static_cast<int32_t>(rows.Int(6));
    const Json tags = Json::parse(rows.Text(7), nullptr, false),
               labels = Json::parse(rows.Text(8), nullptr, false),
               after = Json::parse(rows.Text(24), nullptr, false);
    if (!tags.is_array() || !labels.is_object() || !after.is_array()) {
      return DataLossError("job " + std::to_string(job.job) +
                           ": tags, labels or the jobs before it do not parse");
    }
    plan->tags = tags.get<std::vector<std::string>>();
    plan->labels = labels.get<std::map<std::string, std::string>>();
    plan->after_jobs = after.get<std::vector<JobId>>();
    plan->time_limit_ns = rows.Int(22);
    job.record = {static_cast<JobPhase>(rows.Int(9)),       rows.Text(10), rows.Int(11), rows.Int(12), rows.Int(13),
                  static_cast<int32_t>(rows.Int(21)), rows.Int(23)};
    plan->parent = rows.Int(14);
    plan->content = rows.Text(15);
    if (plan->parent < 0 || JobOf(plan->parent) >= job.job)
      return DataLossError("job " + std::to_string(job.job) + ": submitted by a task of a later job");
    job.plan = std::move(plan);
    job.total = static_cast<uint32_t>(rows.Int(16));
    job.counts = {static_cast<uint32_t>(rows.Int(17)), static_cast<uint32_t>(rows.Int(18)), rows.Real(19)};
    job.archived_ns = rows.Int(20);
    if (!take(std::move(job))) return Status::Ok();
  }
}

Status JobStore::ListJobs(const JobFilter& filter, const std::function<bool(const JobRow&)>& take) {
  const auto list = [](const auto& items) {
    Json numbers = Json::array();
    for (const auto item : items) numbers.push_back(static_cast<int64_t>(item));
    return numbers.dump();
  };
  std::string where = "WHERE submitted_ns >= ?1 AND id < ?2";
  if (!filter.phases.empty()) where += " AND phase IN (SELECT value FROM json_each(?3))";
  if (!filter.ids.empty()) {
    where += " AND id IN (SELECT value FROM json_each(?4))";
  } else if (filter.parent_job == 0 && !filter.any_parent) {
    where += " AND parent = 0";
  } else if (filter.parent_job != 0) {
    where += " AND parent > 0 AND parent BETWEEN ?5 AND ?6";
  }
  if (!filter.by.empty())
    where += " AND (submitted_by = ?7 OR substr(submitted_by, 1, length(?7) + 2) = ?7 || ' (')";
  const auto bind = [&](store::Statement& rows) {
    if (!filter.by.empty()) rows.Bind(7, filter.by);
    rows.Bind(1, filter.since_ns).Bind(2, filter.before > 0 ? filter.before : INT64_MAX);
    if (!filter.phases.empty()) rows.Bind(3, list(filter.phases));
    if (!filter.ids.empty()) rows.Bind(4, list(filter.ids));
    if (!filter.ids.empty() || filter.parent_job == 0) return;
    rows.Bind(5, MakeTaskId(filter.parent_job, 0))
        .Bind(6, MakeTaskId(filter.parent_job, kMaxTasksPerJob - 1));
  };
  return ReadJobs(where + " ORDER BY id DESC", bind, [&](const JobRow& row) { return take(row); });
}

Result<JobRow> JobStore::FindJob(JobId id) {
  JobRow found;
  RG_RETURN_IF_ERROR(ReadJobs(
      "WHERE id = ?", [&](store::Statement& rows) { rows.Bind(1, id); },
      [&](JobRow row) {
        found = std::move(row);
        return false;
      }));
  if (found.job != 0) return found;
  return NotFoundError("there is no job " + std::to_string(id));
}

Result<JobRow> JobStore::FindRequest(const std::string& request_id) {
  JobRow found;
  RG_RETURN_IF_ERROR(ReadJobs(
      "WHERE request_id = ?", [&](store::Statement& rows) { rows.Bind(1, request_id); },
      [&](JobRow row) {
        found = std::move(row);
        return false;
      }));
  if (found.job != 0) return found;
  return NotFoundError("there is no job of the request '" + request_id + "'");
}

Result<Token> JobStore::CommittedToken(TaskId task) {
  RG_ASSIGN_OR_RETURN(auto row, db_->Prepare("SELECT token FROM results WHERE task=?"));
  row.Bind(1, task);
  RG_ASSIGN_OR_RETURN(const bool found, row.Step());
  return found ? static_cast<Token>(row.Int(0)) : Token{0};
}

Status JobStore::LoadTasks(StoredJob* job, JobPlan* plan) {
  const TaskId first = MakeTaskId(job->job, 0), last = MakeTaskId(job->job, kMaxTasksPerJob - 1);
  RG_ASSIGN_OR_RETURN(auto counts, db_->Prepare("SELECT COUNT(*) FROM tasks WHERE id BETWEEN ? AND ?"));
  counts.Bind(1, first).Bind(2, last);
  RG_ASSIGN_OR_RETURN(const bool has_row, counts.Step());
  const auto count = static_cast<size_t>(has_row ? counts.Int(0) : 0);
  job->tasks.resize(count);
  plan->tasks.resize(count);
  RG_ASSIGN_OR_RETURN(auto rows, db_->Prepare(kTaskColumns));
  rows.Bind(1, first).Bind(2, last);
  while (true) {
    RG_ASSIGN_OR_RETURN(const bool more, rows.Step());
    if (!more) return Status::Ok();
    const uint32_t index = IndexOf(rows.Int(0));
    if (index >= count)
      return DataLossError("task " + std::to_string(rows.Int(0)) + ": one before it is missing in its job");
    RG_RETURN_IF_ERROR(TakeTask(rows, static_cast<uint32_t>(count), &plan->tasks[index], &job->tasks[index]));
  }
}

Result<std::vector<StoredTask>> JobStore::ReadPlans(TaskId first, TaskId last) {
  RG_ASSIGN_OR_RETURN(auto rows, db_->Prepare(kTaskColumns));
  rows.Bind(1, first).Bind(2, last);
  std::vector<StoredTask> tasks;
  while (true) {
    RG_ASSIGN_OR_RETURN(const bool more, rows.Step());
    if (!more) return tasks;
    StoredTask& task = tasks.emplace_back();
    task.task = rows.Int(0);
    RG_RETURN_IF_ERROR(TakeTask(rows, kMaxTasksPerJob, &task.plan, &task.record));
  }
}

Result<std::vector<StageRow>> JobStore::Stages(JobId job) {
  RG_ASSIGN_OR_RETURN(
      auto rows,
      db_->Prepare("SELECT stage, COUNT(*), SUM(phase = 4), SUM(phase IN (5, 7)), SUM(weight), "
                   "SUM(CASE phase WHEN 4 THEN weight ELSE 0 END), COALESCE(MIN(NULLIF(started_ns, 0)), 0), "
                   "MAX(finished_ns) FROM tasks WHERE id BETWEEN ? AND ? GROUP BY stage ORDER BY MIN(id)"));
  rows.Bind(1, MakeTaskId(job, 0)).Bind(2, MakeTaskId(job, kMaxTasksPerJob - 1));
  std::vector<StageRow> stages;
  while (true) {
    RG_ASSIGN_OR_RETURN(const bool more, rows.Step());
    if (!more) return stages;
    stages.push_back({rows.Text(0), static_cast<uint32_t>(rows.Int(1)), static_cast<uint32_t>(rows.Int(2)),
                      static_cast<uint32_t>(rows.Int(3)), rows.Real(4), rows.Real(5), rows.Int(6),
                      rows.Int(7)});
  }
}

// Above everything that was ever given, though it may have been deleted since.
Status JobStore::LoadHighWater(StoredState* out) {
  const auto number = [&](std::string_view sql) -> Result<int64_t> {
    RG_ASSIGN_OR_RETURN(auto row, db_->Prepare(sql));
    RG_ASSIGN_OR_RETURN(const bool found, row.Step());
    return found ? row.Int(0) : 0;
  };
  constexpr const char* kMark = "SELECT COALESCE(MAX(value), 0) FROM high_water WHERE name = ";
  RG_ASSIGN_OR_RETURN(const int64_t token, number("SELECT COALESCE(MAX(token), 0) FROM attempts"));
  RG_ASSIGN_OR_RETURN(const int64_t token_mark, number(std::string(kMark) + "'token'"));
  RG_ASSIGN_OR_RETURN(const int64_t job, number("SELECT COALESCE(MAX(id), 0) FROM jobs"));
  RG_ASSIGN_OR_RETURN(const int64_t job_mark, number(std::string(kMark) + "'job'"));
  RG_ASSIGN_OR_RETURN(out->newest_of_clients,
                      number("SELECT id FROM jobs WHERE parent = 0 ORDER BY id DESC LIMIT 1"));
  out->last_token = static_cast<Token>(std::max(token, token_mark));
  out->last_job = std::max(job, job_mark);
  return Status::Ok();
}

Status JobStore::LoadHolds(StoredState* out) {
  RG_ASSIGN_OR_RETURN(auto rows, db_->Prepare("SELECT robot, reason, held_by, since_ns FROM robot_holds"));
  while (true) {
    RG_ASSIGN_OR_RETURN(const bool more, rows.Step());
    if (!more) return Status::Ok();
    out->holds[rows.Text(0)] = {rows.Text(1), rows.Text(2), rows.Int(3)};
  }
}

Status JobStore::LoadOpenAttempts(StoredState* out) {
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
