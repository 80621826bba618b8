#include "coordinator/store/schema.h"

namespace rg::coordinator {
namespace {

// Times are wall nanoseconds; 0 or NULL: not yet. Numbers of phase and outcome: core/types.h.
constexpr std::string_view kVersion1 = R"sql(
CREATE TABLE jobs (
  id INTEGER PRIMARY KEY,
  request_id TEXT NOT NULL UNIQUE,
  kind TEXT NOT NULL,
  name TEXT NOT NULL,
  submitted_by TEXT NOT NULL,
  spec_json TEXT NOT NULL,
  priority INTEGER NOT NULL,
  tags_json TEXT NOT NULL,
  labels_json TEXT NOT NULL,
  phase INTEGER NOT NULL,
  reason TEXT NOT NULL DEFAULT '',
  submitted_ns INTEGER NOT NULL,
  started_ns INTEGER NOT NULL DEFAULT 0,
  finished_ns INTEGER NOT NULL DEFAULT 0
);
-- id = job * 2^24 + index in the job
CREATE TABLE tasks (
  id INTEGER PRIMARY KEY,
  name TEXT NOT NULL,
  stage TEXT NOT NULL,
  kind TEXT NOT NULL,
  tags TEXT NOT NULL,          -- one per line
  parents BLOB NOT NULL,       -- little-endian uint32 each: index * 2 + optional
  priority INTEGER NOT NULL,
  max_attempts INTEGER NOT NULL,
  crash_limit INTEGER NOT NULL,
  at_most_once INTEGER NOT NULL,
  weight REAL NOT NULL,
  phase INTEGER NOT NULL,
  attempts INTEGER NOT NULL DEFAULT 0,
  failures INTEGER NOT NULL DEFAULT 0,
  crashes INTEGER NOT NULL DEFAULT 0,
  losses INTEGER NOT NULL DEFAULT 0,
  token INTEGER NOT NULL DEFAULT 0,
  set_aside INTEGER NOT NULL DEFAULT 0,
  reason TEXT NOT NULL DEFAULT '',
  started_ns INTEGER NOT NULL DEFAULT 0,
  finished_ns INTEGER NOT NULL DEFAULT 0
);
CREATE TABLE task_specs (
  task INTEGER PRIMARY KEY,
  spec BLOB NOT NULL           -- realitygrad.v1.TaskSpec
);
CREATE TABLE attempts (
  token INTEGER PRIMARY KEY,
  task INTEGER NOT NULL,
  number INTEGER NOT NULL,
  worker TEXT NOT NULL,
  instance TEXT NOT NULL,
  leased_ns INTEGER NOT NULL,
  granted_ns INTEGER NOT NULL DEFAULT 0,
  finished_ns INTEGER NOT NULL DEFAULT 0,
  outcome INTEGER NOT NULL DEFAULT 0,
  error TEXT NOT NULL DEFAULT ''
);
CREATE INDEX attempts_by_task ON attempts (task);
CREATE INDEX attempts_open ON attempts (outcome) WHERE outcome = 0;
CREATE TABLE results (
  task INTEGER PRIMARY KEY,    -- at most one committed result per task
  token INTEGER NOT NULL,
  summary_json TEXT NOT NULL,
  seconds REAL NOT NULL
);
CREATE TABLE outputs (
  task INTEGER NOT NULL,
  position INTEGER NOT NULL,
  name TEXT NOT NULL,
  kind TEXT NOT NULL,
  sha256 TEXT NOT NULL,
  size INTEGER NOT NULL,
  metadata_json TEXT NOT NULL,
  PRIMARY KEY (task, position)
) WITHOUT ROWID;
CREATE TABLE checkpoints (
  task INTEGER PRIMARY KEY,
  token INTEGER NOT NULL,
  sequence INTEGER NOT NULL,
  bytes BLOB NOT NULL
);
CREATE TABLE task_logs (
  sequence INTEGER PRIMARY KEY AUTOINCREMENT,
  task INTEGER NOT NULL,
  attempt INTEGER NOT NULL,
  wall_ns INTEGER NOT NULL,
  text TEXT NOT NULL
);
CREATE INDEX task_logs_by_task ON task_logs (task, sequence);
CREATE TABLE events (
  id INTEGER PRIMARY KEY AUTOINCREMENT,
  wall_ns INTEGER NOT NULL,
  job INTEGER NOT NULL,
  task TEXT NOT NULL,
  worker TEXT NOT NULL,
  kind TEXT NOT NULL,
  detail TEXT NOT NULL
);
CREATE INDEX events_by_job ON events (job, id);
)sql";

// Jobs that tasks submit: the task's id; 0: a client submitted it.
constexpr std::string_view kVersion2 = R"sql(
ALTER TABLE jobs ADD COLUMN parent INTEGER NOT NULL DEFAULT 0;
)sql";

// With which key a worker took a lease; what a job asked for (a hash), to tell a repeat from another job
// under the same request id; which artefacts jobs need, so that none of them is collected.
constexpr std::string_view kVersion3 = R"sql(
ALTER TABLE attempts ADD COLUMN key TEXT NOT NULL DEFAULT '';
ALTER TABLE jobs ADD COLUMN content TEXT NOT NULL DEFAULT '';
-- The artefacts that the tasks of a job name as inputs; complete where jobs.inputs_listed is set.
ALTER TABLE jobs ADD COLUMN inputs_listed INTEGER NOT NULL DEFAULT 0;
CREATE TABLE job_inputs (
  job INTEGER NOT NULL,
  sha256 TEXT NOT NULL,
  PRIMARY KEY (job, sha256)
) WITHOUT ROWID;
)sql";

// What a listing says of jobs that have left memory; the way to those that have not; archived jobs: their
// tasks as replies of a thousand each, in place of their rows.
constexpr std::string_view kVersion4 = R"sql(
ALTER TABLE jobs ADD COLUMN tasks_total INTEGER NOT NULL DEFAULT 0;
ALTER TABLE jobs ADD COLUMN tasks_succeeded INTEGER NOT NULL DEFAULT 0;
ALTER TABLE jobs ADD COLUMN tasks_failed INTEGER NOT NULL DEFAULT 0;
ALTER TABLE jobs ADD COLUMN progress REAL NOT NULL DEFAULT 0;
ALTER TABLE jobs ADD COLUMN archived_ns INTEGER NOT NULL DEFAULT 0;
UPDATE jobs SET tasks_total = (SELECT count(*) FROM tasks WHERE tasks.id BETWEEN jobs.id << 24 AND
  (jobs.id << 24) + 16777215);
UPDATE jobs SET
  tasks_succeeded = (SELECT count(*) FROM tasks WHERE tasks.id BETWEEN jobs.id << 24 AND
    (jobs.id << 24) + 16777215 AND phase = 4),
  tasks_failed = (SELECT count(*) FROM tasks WHERE tasks.id BETWEEN jobs.id << 24 AND
    (jobs.id << 24) + 16777215 AND phase IN (5, 7)),
  progress = (SELECT coalesce(sum(CASE phase WHEN 4 THEN weight ELSE 0 END) / max(sum(weight), 1e-12), 0)
    FROM tasks WHERE tasks.id BETWEEN jobs.id << 24 AND (jobs.id << 24) + 16777215)
  WHERE phase IN (4, 5, 6);
UPDATE jobs SET progress = 1 WHERE phase = 4;
CREATE INDEX jobs_live ON jobs (phase) WHERE phase IN (1, 2, 3);
CREATE INDEX jobs_of_tasks ON jobs (parent) WHERE parent > 0;
CREATE INDEX jobs_to_archive ON jobs (finished_ns) WHERE finished_ns > 0 AND archived_ns = 0;
CREATE TABLE archived_jobs (
  job INTEGER PRIMARY KEY,
  overview BLOB NOT NULL,      -- realitygrad.v1.GetJobReply without tasks
  next_task INTEGER NOT NULL   -- tasks before it are in archived_tasks, the rows of the others still there
);
CREATE TABLE archived_tasks (
  first INTEGER PRIMARY KEY,   -- id of the first task
  tasks BLOB NOT NULL          -- realitygrad.v1.GetJobReply with tasks only
);
CREATE TABLE archived_outputs (
  job INTEGER NOT NULL,
  sha256 TEXT NOT NULL,
  PRIMARY KEY (job, sha256)
) WITHOUT ROWID;
-- Numbers that must never be given again, whatever was deleted.
CREATE TABLE high_water (
  name TEXT PRIMARY KEY,       -- 'job', 'token'
  value INTEGER NOT NULL
) WITHOUT ROWID;
)sql";

// A priority that was changed later (added to those of the job's tasks), time limits, jobs after others.
constexpr std::string_view kVersion5 = R"sql(
ALTER TABLE jobs ADD COLUMN priority_shift INTEGER NOT NULL DEFAULT 0;
ALTER TABLE jobs ADD COLUMN time_limit_ns INTEGER NOT NULL DEFAULT 0;
ALTER TABLE jobs ADD COLUMN deadline_ns INTEGER NOT NULL DEFAULT 0;
ALTER TABLE jobs ADD COLUMN after_json TEXT NOT NULL DEFAULT '[]';
)sql";

constexpr std::string_view kVersion6 = R"sql(
CREATE TABLE robot_holds (
  robot TEXT PRIMARY KEY,
  reason TEXT NOT NULL,
  held_by TEXT NOT NULL,
  since_ns INTEGER NOT NULL
) WITHOUT ROWID;
)sql";

}  // namespace

store::Module CoordinatorSchema() {
  return {"coordinator", {{1, kVersion1}, {2, kVersion2}, {3, kVersion3}, {4, kVersion4}, {5, kVersion5}, {6, kVersion6}}};
}

}  // namespace rg::coordinator
