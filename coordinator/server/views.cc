#include "coordinator/server/views.h"

#include <algorithm>

namespace rg::coordinator {
namespace {

double FractionOf(const Lease& lease) {
  return lease.progress_total > 0.0 ? std::clamp(lease.progress_done / lease.progress_total, 0.0, 1.0) : 0.0;
}

const Lease* LeaseOf(const State& state, const Task& task) {
  const auto* leased = std::get_if<TaskLeased>(&task.status);
  if (leased == nullptr) return nullptr;
  const auto found = state.leases.find(leased->token);
  return found == state.leases.end() ? nullptr : &found->second;
}

void FillProgress(const Lease& lease, pb::TaskProgress* out) {
  out->set_stage(lease.progress_stage);
  out->set_done(lease.progress_done);
  out->set_total(lease.progress_total);
  out->set_note(lease.progress_note);
}

void FillSummary(JobId id, const JobPlan& plan, const JobRecord& record, pb::JobSummary* out) {
  out->set_id(id);
  out->set_kind(plan.kind);
  out->set_name(plan.name);
  out->set_submitted_by(plan.submitted_by);
  out->set_state(static_cast<pb::JobState>(record.phase));
  out->set_reason(record.reason);
  out->set_priority(plan.priority + record.priority_shift);
  out->mutable_after_jobs()->Assign(plan.after_jobs.begin(), plan.after_jobs.end());
  out->set_time_limit_s(1e-9 * static_cast<double>(plan.time_limit_ns));
  out->set_deadline_ns(record.deadline_ns);
  for (const std::string& tag : plan.tags) out->add_tags(tag);
  out->mutable_labels()->insert(plan.labels.begin(), plan.labels.end());
  out->set_submitted_ns(record.submitted_ns);
  out->set_started_ns(record.started_ns);
  out->set_finished_ns(record.finished_ns);
  if (plan.parent != 0) out->set_parent_job(JobOf(plan.parent));
}

// By the rate so far, once there is one.
double EstimateSecondsLeft(const Job& job, double progress, int64_t wall_ns) {
  constexpr double kTooEarly = 0.02;
  if (IsFinal(job.record.phase)) return 0.0;
  if (job.record.started_ns == 0 || progress < kTooEarly) return -1.0;
  const double elapsed = 1e-9 * static_cast<double>(wall_ns - job.record.started_ns);
  return elapsed * (1.0 - progress) / progress;
}

}  // namespace

std::map<JobId, double> WeightUnderWay(const State& state) {
  std::map<JobId, double> sums;
  for (const auto& [token, lease] : state.leases) {
    const Job* job = state.FindJob(JobOf(lease.task));
    if (job != nullptr) sums[job->id] += job->plan_of(IndexOf(lease.task)).weight * FractionOf(lease);
  }
  return sums;
}

void FillTask(TaskId id, const TaskPlan& plan, const TaskRecord& record, const TaskRows& rows,
              pb::TaskInfo* out) {
  out->set_id(id);
  out->set_job(JobOf(id));
  out->set_name(plan.name);
  out->set_stage(plan.stage);
  out->set_kind(plan.kind);
  out->set_state(static_cast<pb::TaskState>(record.phase));
  out->set_attempts(record.attempts);
  out->set_at_most_once(plan.at_most_once);
  for (const std::string& tag : plan.required_tags) out->add_required_tags(tag);
  out->set_set_aside(record.set_aside);
  if (const auto detail = rows.details.find(id); detail != rows.details.end()) {
    out->set_reason(detail->second.reason);
    out->set_started_ns(detail->second.started_ns);
    out->set_finished_ns(detail->second.finished_ns);
    out->set_summary_json(detail->second.summary_json);
  }
  const auto [first_output, last_output] = rows.outputs.equal_range(id);
  for (auto it = first_output; it != last_output; ++it) {
    pb::TaskOutput* output = out->add_outputs();
    output->set_name(it->second.name);
    output->set_kind(it->second.kind);
    output->set_sha256(it->second.sha256);
    output->set_size(static_cast<uint64_t>(it->second.size));
    output->set_metadata_json(it->second.metadata_json);
  }
  const auto [first_attempt, last_attempt] = rows.attempts.equal_range(id);
  for (auto it = first_attempt; it != last_attempt; ++it) {
    const AttemptRow& row = it->second;
    pb::AttemptInfo* attempt = out->add_attempt_list();
    attempt->set_number(row.number);
    attempt->set_token(row.token);
    attempt->set_worker(row.worker);
    attempt->set_leased_ns(row.leased_ns);
    attempt->set_finished_ns(row.finished_ns);
    attempt->set_outcome(static_cast<pb::AttemptOutcome>(row.outcome));
    attempt->set_error(row.error);
  }
}

pb::JobSummary SummaryOf(const JobRow& row) {
  pb::JobSummary out;
  FillSummary(row.job, *row.plan, row.record, &out);
  out.set_tasks_total(row.total);
  out.set_tasks_done(row.counts.succeeded);
  out.set_tasks_failed(row.counts.failed);
  out.set_progress(row.counts.progress);
  out.set_eta_s(IsFinal(row.record.phase) ? 0.0 : -1.0);
  out.set_revision(1);
  out.set_archived_ns(row.archived_ns);
  return out;
}

pb::JobSummary SummaryOf(const Job& job, double weight_under_way, int64_t wall_ns) {
  pb::JobSummary out;
  FillSummary(job.id, *job.plan, job.record, &out);
  out.mutable_waits_for()->Assign(job.waits_for.begin(), job.waits_for.end());
  out.set_tasks_total(static_cast<uint32_t>(job.tasks.size()));
  out.set_tasks_done(job.succeeded);
  out.set_tasks_running(job.leased);
  out.set_tasks_failed(job.failed + job.uncertain);
  const double total = std::max(job.weight_total, 1e-12);
  const double progress =
      job.record.phase == JobPhase::kSucceeded ? 1.0 : (job.weight_done + weight_under_way) / total;
  out.set_progress(std::clamp(progress, 0.0, 1.0));
  out.set_eta_s(EstimateSecondsLeft(job, out.progress(), wall_ns));
  out.set_revision(job.revision);
  return out;
}

pb::WorkerInfo InfoOf(const Worker& worker, const State& state, int64_t steady_ns) {
  pb::WorkerInfo out;
  out.set_name(worker.name);
  out.set_host(worker.host);
  out.set_pid(worker.pid);
  for (const std::string& tag : worker.tags) out.add_tags(tag);
  for (const std::string& kind : worker.kinds) out.add_kinds(kind);
  out.set_slots(worker.slots);
  out.set_busy(std::min(worker.busy(), worker.slots));  // what is at hand for later takes no slot
  out.set_draining(worker.draining);
  out.set_connected(worker.connected);
  out.set_last_seen_s(1e-9 * static_cast<double>(steady_ns - worker.last_seen_ns));
  out.set_since_ns(worker.since_wall_ns);
  out.set_tasks_done(worker.tasks_done);
  out.set_tasks_failed(worker.tasks_failed);
  for (const Token token : worker.leases) {
    const auto lease = state.leases.find(token);
    if (lease != state.leases.end()) out.add_running(lease->second.task);
  }
  out.set_version(worker.version);
  out.set_unable(worker.why_unable());
  out.set_drain_reason(worker.drain_reason);
  out.set_disk_free_bytes(worker.node.disk_free_bytes);
  out.set_memory_free_bytes(worker.node.memory_free_bytes);
  out.set_load(worker.node.load);
  out.set_robot_state(worker.node.robot);
  out.set_last_error(worker.last_error);
  return out;
}

void FillStages(const State& state, const Job& job, pb::GetJobReply* reply) {
  std::vector<double> done(job.stages.size()), total(job.stages.size());
  for (const std::string& name : job.stages) reply->add_stages()->set_name(name);
  for (uint32_t i = 0; i < job.tasks.size(); ++i) {
    const Task& task = job.tasks[i];
    const double weight = job.plan_of(i).weight;
    pb::StageInfo* stage = reply->mutable_stages(static_cast<int>(task.stage));
    stage->set_total(stage->total() + 1);
    total[task.stage] += weight;
    const TaskPhase phase = PhaseOf(task.status);
    if (phase == TaskPhase::kSucceeded) stage->set_done(stage->done() + 1), done[task.stage] += weight;
    if (phase == TaskPhase::kFailed || phase == TaskPhase::kUncertain) stage->set_failed(stage->failed() + 1);
    if (const Lease* lease = LeaseOf(state, task)) {
      stage->set_running(stage->running() + 1);
      done[task.stage] += weight * FractionOf(*lease);
      if (!lease->progress_stage.empty() || lease->progress_total > 0.0)
        FillProgress(*lease, stage->mutable_latest());
    }
    if (task.started_ns > 0 && (stage->started_ns() == 0 || task.started_ns < stage->started_ns())) {
      stage->set_started_ns(task.started_ns);
    }
    stage->set_finished_ns(std::max(stage->finished_ns(), task.finished_ns));
  }
  for (int s = 0; s < reply->stages_size(); ++s) {
    const auto i = static_cast<size_t>(s);
    reply->mutable_stages(s)->set_progress(total[i] > 0.0 ? done[i] / total[i] : 0.0);
    if (reply->stages(s).done() + reply->stages(s).failed() < reply->stages(s).total()) {
      reply->mutable_stages(s)->set_finished_ns(0);
    }
  }
}

namespace {

void FillLiveTask(const State& state, const Job& job, uint32_t index, const TaskRows& rows,
                  pb::TaskInfo* out) {
  FillTask(MakeTaskId(job.id, index), job.plan_of(index), RecordOf(job, index), rows, out);
  if (const Lease* lease = LeaseOf(state, job.tasks[index])) {
    out->set_worker(lease->worker);
    FillProgress(*lease, out->mutable_progress());
  }
}

}  // namespace

Status FillTasks(const State& state, const Job& job, bool with_attempts, uint32_t first, size_t max_bytes,
                 JobStore& store, pb::GetJobReply* reply) {
  constexpr uint32_t kRowsAtOnce = 1000;
  const auto count = static_cast<uint32_t>(job.tasks.size());
  size_t bytes = 0;
  for (uint32_t begin = first; begin < count; begin += kRowsAtOnce) {
    const uint32_t end = std::min(count, begin + kRowsAtOnce);
    RG_ASSIGN_OR_RETURN(const TaskRows rows, store.ReadTasks(MakeTaskId(job.id, begin),
                                                             MakeTaskId(job.id, end - 1), with_attempts));
    for (uint32_t i = begin; i < end; ++i) {
      if (bytes > max_bytes) return reply->set_next_task(i), Status::Ok();
      FillLiveTask(state, job, i, rows, reply->add_tasks());
      bytes += reply->tasks(reply->tasks_size() - 1).ByteSizeLong();
    }
  }
  return Status::Ok();
}

int64_t FindTask(const Job& job, const std::string& name) {
  const auto& tasks = job.plan->tasks;
  const auto found =
      std::find_if(tasks.begin(), tasks.end(), [&](const TaskPlan& t) { return t.name == name; });
  return found == tasks.end() ? -1 : found - tasks.begin();
}

}  // namespace rg::coordinator
