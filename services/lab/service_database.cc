// A database as a year of work leaves it, written with SQL: a hundred times as fast as running the tasks.
#include "common/store/database.h"
#include "services/lab/service_bench.h"

namespace rg::lab {
namespace {

constexpr int64_t kJobsEnded = 99;

std::string Number(int64_t value) { return std::to_string(value); }

// `count` tasks of job `job` in `phase`; those that succeeded with their attempt and result.
Status InsertJob(store::Database& database, int64_t job, int64_t count, bool ended) {
  const std::string id = Number(job), tasks = Number(count), first = "(" + id + " << 24)";
  const std::string numbers =
      "WITH RECURSIVE n(i) AS (SELECT 0 UNION ALL SELECT i + 1 FROM n WHERE i + 1 < " + tasks + ") ";
  RG_RETURN_IF_ERROR(database.Execute(
      "INSERT INTO jobs (id, request_id, kind, name, submitted_by, spec_json, priority, tags_json, "
      "labels_json, phase, submitted_ns, started_ns, finished_ns, inputs_listed, tasks_total, "
      "tasks_succeeded, progress) VALUES (" +
      id + ", 'bench-" + id + "', 'bench', '', 'bench', '{}', 0, '[]', '{}', " + (ended ? "4" : "1") +
      ", 1000, " + (ended ? "1000, 2000" : "0, 0") + ", 1, " + tasks + ", " + (ended ? tasks : "0") + ", " +
      (ended ? "1" : "0") + ")"));
  RG_RETURN_IF_ERROR(database.Execute(
      numbers +
      "INSERT INTO tasks (id, name, stage, kind, tags, parents, priority, max_attempts, crash_limit, "
      "at_most_once, weight, phase, attempts, token, started_ns, finished_ns) SELECT " +
      first + " + i, 't' || i, 'bench', 'simulated', '', x'', 0, 3, 3, 0, 1.0, " +
      (ended ? "4, 1, " + first + " + i, 1000, 2000" : "1, 0, 0, 0, 0") + " FROM n"));
  RG_RETURN_IF_ERROR(database.Execute(numbers + "INSERT INTO task_specs (task, spec) SELECT " + first +
                                      " + i, zeroblob(0) FROM n"));
  if (!ended) return Status::Ok();
  RG_RETURN_IF_ERROR(database.Execute(numbers +
                                      "INSERT INTO attempts (token, task, number, worker, instance, "
                                      "leased_ns, finished_ns, outcome) SELECT " +
                                      first + " + i, " + first +
                                      " + i, 1, 'a-1', 'a-1-4711', 1000, 2000, 1 FROM n"));
  return database.Execute(numbers + "INSERT INTO results (task, token, summary_json, seconds) SELECT " +
                          first + " + i, " + first +
                          " + i, printf('{\"result\":\"%01000d\"}', i), 0.1 FROM n");
}

}  // namespace

Status FillServiceDatabase(const std::string& path, int64_t ended, int64_t live) {
  store::DatabaseOptions options;
  options.path = path;
  options.durable = false;
  RG_ASSIGN_OR_RETURN(const auto database, store::Database::Open(options, {}));
  const int64_t each = (ended + kJobsEnded - 1) / kJobsEnded;
  int64_t job = 0;
  for (int64_t left = ended; left > 0; left -= each) {
    RG_RETURN_IF_ERROR(
        database->InTransaction([&] { return InsertJob(*database, ++job, std::min(left, each), true); }));
  }
  RG_RETURN_IF_ERROR(database->InTransaction([&] { return InsertJob(*database, ++job, live, false); }));
  return database->Checkpoint();
}

}  // namespace rg::lab
