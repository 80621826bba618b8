// The durable side of the coordinator, in memory: applies the reactor's rows and gives the stored
// state back, as the SQLite store does. The two are compared in job_store_test.cc.
#pragma once

#include <map>
#include <vector>

#include "coordinator/core/events.h"
#include "coordinator/core/state.h"

namespace rg::coordinator {

class MemoryStore {
 public:
  void Apply(const std::vector<Row>& rows) {
    for (const Row& row : rows) std::visit([this](const auto& r) { ApplyOne(r); }, row);
  }

  StoredState Load() const {
    StoredState out;
    for (const auto& [id, job] : jobs_) {
      if (!IsFinal(job.record.phase)) out.jobs.push_back(job);
      if (job.plan->parent == 0) out.newest_of_clients = id;
      out.last_job = id;
    }
    for (const auto& [token, attempt] : open_) out.open_attempts.push_back(attempt);
    out.last_token = last_token_;
    out.holds = holds_;
    return out;
  }
  // All that ever were, over or not.
  const std::map<JobId, StoredJob>& jobs() const { return jobs_; }
  const StoredJob* Find(JobId id) const {
    const auto found = jobs_.find(id);
    return found == jobs_.end() ? nullptr : &found->second;
  }

  // What the shell looks up for the core before it hands it an event: of jobs that are not in memory.
  void Complete(Event& event, State& state) const {
    if (auto* submit = std::get_if<Submit>(&event)) {
      const auto known = job_by_request_.find(submit->request_id);
      if (known == job_by_request_.end()) return submit->unmet = UnmetOf(*submit->plan, state), void();
      submit->known = known->second;
      submit->known_content = jobs_.at(known->second).plan->content;
    } else if (auto* finished = std::get_if<Finished>(&event)) {
      const StoredJob* job = Find(JobOf(finished->task));
      if (job == nullptr || IndexOf(finished->task) >= job->tasks.size()) return;
      const TaskRecord& task = job->tasks[IndexOf(finished->task)];
      if (task.phase == TaskPhase::kSucceeded) finished->committed = task.token;
    } else if (auto* command = std::get_if<CommandJob>(&event)) {
      const StoredJob* job = Find(command->job);
      if (job == nullptr) return;
      command->unmet = UnmetOf(*job->plan, state);
      if (state.FindJob(command->job) != nullptr) return;
      state.ended.push_back(command->job);
      Recall(state, *job);
    }
  }

  // How often each task's result was committed, and which events were noted how often.
  std::map<TaskId, int> commits;
  std::map<std::string, int> notes;

 private:
  // Of the jobs that it comes after, one that has left memory without success.
  JobId UnmetOf(const JobPlan& plan, const State& state) const {
    for (const JobId id : plan.after_jobs) {
      if (state.FindJob(id) == nullptr && jobs_.at(id).record.phase != JobPhase::kSucceeded) return id;
    }
    return 0;
  }
  TaskRecord& TaskOf(TaskId task) { return jobs_.at(JobOf(task)).tasks.at(IndexOf(task)); }

  void ApplyOne(const InsertJob& row) {
    StoredJob& job = jobs_[row.job];
    job_by_request_[row.request_id] = row.job;
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
  void ApplyOne(const SetHold& row) {
    if (row.released) holds_.erase(row.robot);
    if (!row.released) holds_[row.robot] = row.hold;
  }
  void ApplyOne(const AppendEvent& row) { ++notes[row.kind]; }

  std::map<JobId, StoredJob> jobs_;
  std::map<std::string, RobotHold> holds_;
  std::map<std::string, JobId> job_by_request_;
  std::map<Token, OpenAttempt> open_;
  Token last_token_ = 0;
};

}  // namespace rg::coordinator
