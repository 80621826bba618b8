// The durable side of the coordinator, in memory: applies the reactor's rows and gives the stored
// state back, as the SQLite store does. The two are compared in job_store_test.cc.
#pragma once

#include <map>
#include <vector>

#include "coordinator/core/events.h"

namespace rg::coordinator {

class MemoryStore {
 public:
  void Apply(const std::vector<Row>& rows) {
    for (const Row& row : rows) std::visit([this](const auto& r) { ApplyOne(r); }, row);
  }

  StoredState Load() const {
    StoredState out;
    for (const auto& [id, job] : jobs_) out.jobs.push_back(job);
    for (const auto& [token, attempt] : open_) out.open_attempts.push_back(attempt);
    out.last_token = last_token_;
    return out;
  }

  // How often each task's result was committed, and which events were noted how often.
  std::map<TaskId, int> commits;
  std::map<std::string, int> notes;

 private:
  TaskRecord& TaskOf(TaskId task) { return jobs_.at(JobOf(task)).tasks.at(IndexOf(task)); }

  void ApplyOne(const InsertJob& row) {
    StoredJob& job = jobs_[row.job];
    job.job = row.job;
    job.request_id = row.request_id;
    job.record.submitted_ns = row.submitted_ns;
    job.plan = row.plan;
    job.tasks.resize(row.plan->tasks.size());
  }
  void ApplyOne(const UpdateJob& row) { jobs_.at(row.job).record = row.record; }
  void ApplyOne(const UpdateTask& row) { TaskOf(row.task) = row.record; }
  void ApplyOne(const InsertAttempt& row) {
    open_[row.token] = {row.task, row.token, row.number, row.worker, row.instance, row.key, false};
    last_token_ = std::max(last_token_, row.token);
  }
  void ApplyOne(const GrantAttempt& row) { open_.at(row.token).granted = true; }
  void ApplyOne(const FinishAttempt& row) { open_.erase(row.token); }
  void ApplyOne(const CommitResult& row) { ++commits[row.task]; }
  void ApplyOne(const CloseTasks& row) {
    for (TaskRecord& task : jobs_.at(row.job).tasks) {
      if (task.phase == TaskPhase::kSucceeded || task.phase == TaskPhase::kFailed) continue;
      task.phase = TaskPhase::kCancelled;
      task.token = 0;
    }
    std::erase_if(open_, [&](const auto& entry) { return JobOf(entry.second.task) == row.job; });
  }
  void ApplyOne(const ReopenTasks& row) {
    for (TaskRecord& task : jobs_.at(row.job).tasks) {
      if (task.phase == TaskPhase::kSucceeded) continue;
      task.phase = TaskPhase::kWaiting;
      task.failures = task.crashes = task.losses = 0;
      task.token = 0;
      task.set_aside = false;
    }
  }
  void ApplyOne(const AppendEvent& row) { ++notes[row.kind]; }

  std::map<JobId, StoredJob> jobs_;
  std::map<Token, OpenAttempt> open_;
  Token last_token_ = 0;
};

}  // namespace rg::coordinator
