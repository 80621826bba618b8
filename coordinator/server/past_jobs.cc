#include "coordinator/server/past_jobs.h"

#include <algorithm>

#include "coordinator/server/views.h"

namespace rg::coordinator {
namespace {

constexpr uint32_t kTogether = JobStore::kArchivedTogether;

void FillStages(const std::vector<StageRow>& stages, pb::GetJobReply* reply) {
  for (const StageRow& row : stages) {
    pb::StageInfo* out = reply->add_stages();
    out->set_name(row.name);
    out->set_total(row.total);
    out->set_done(row.done);
    out->set_failed(row.failed);
    out->set_started_ns(row.started_ns);
    if (row.done + row.failed >= row.total) out->set_finished_ns(row.finished_ns);
    out->set_progress(row.weight > 0.0 ? row.weight_done / row.weight : 0.0);
  }
}

Result<pb::GetJobReply> Overview(JobStore& store, const JobRow& row) {
  pb::GetJobReply reply;
  RG_ASSIGN_OR_RETURN(const std::string archived, store.ArchivedOverview(row.job));
  if (!archived.empty() && !reply.ParseFromString(archived))
    return DataLossError("job " + std::to_string(row.job) + ": its archive does not parse");
  if (archived.empty()) {
    RG_ASSIGN_OR_RETURN(const auto stages, store.Stages(row.job));
    FillStages(stages, &reply);
    reply.set_spec_json(row.plan->spec_json);
  }
  *reply.mutable_job() = SummaryOf(row);
  return reply;
}

// The tasks of one thousand: `first` is the first of them.
Result<pb::GetJobReply> ReadThousand(JobStore& store, TaskId first, TaskId last, bool is_archived) {
  pb::GetJobReply page;
  if (is_archived) {
    RG_ASSIGN_OR_RETURN(const std::string bytes, store.ArchivedTasks(first));
    if (!page.ParseFromString(bytes))
      return DataLossError("the archived tasks at " + std::to_string(first) + " do not parse");
    return page;
  }
  RG_ASSIGN_OR_RETURN(const auto tasks, store.ReadPlans(first, last));
  RG_ASSIGN_OR_RETURN(const TaskRows rows, store.ReadTasks(first, last, true));
  for (const StoredTask& task : tasks) FillTask(task.task, task.plan, task.record, rows, page.add_tasks());
  return page;
}

// From request.first_task() on, until the reply has about `page_bytes`.
Status AddTasks(JobStore& store, const JobRow& row, const pb::GetJobRequest& request, size_t page_bytes,
                pb::GetJobReply* reply) {
  RG_ASSIGN_OR_RETURN(const uint32_t unarchived, store.FirstUnarchived(row.job));
  size_t bytes = 0;
  for (uint32_t begin = request.first_task(); begin < row.total;) {
    const uint32_t first = begin / kTogether * kTogether;
    const uint32_t end = std::min(row.total, first + kTogether);
    RG_ASSIGN_OR_RETURN(pb::GetJobReply page, ReadThousand(store, MakeTaskId(row.job, first),
                                                           MakeTaskId(row.job, end - 1), first < unarchived));
    for (pb::TaskInfo& task : *page.mutable_tasks()) {
      const uint32_t index = IndexOf(task.id());
      if (index < begin) continue;
      if (bytes > page_bytes) return reply->set_next_task(index), Status::Ok();
      if (!request.with_attempts()) task.clear_attempt_list();
      bytes += task.ByteSizeLong();
      *reply->add_tasks() = std::move(task);
    }
    begin = end;
  }
  return Status::Ok();
}

// The task of that name; without one the first that failed, else the first.
Result<pb::TaskInfo> TaskOfInterest(JobStore& store, const JobRow& row, const std::string& name) {
  RG_ASSIGN_OR_RETURN(const uint32_t unarchived, store.FirstUnarchived(row.job));
  pb::TaskInfo first;
  for (uint32_t begin = 0; begin < row.total; begin += kTogether) {
    const uint32_t end = std::min(row.total, begin + kTogether);
    RG_ASSIGN_OR_RETURN(pb::GetJobReply page, ReadThousand(store, MakeTaskId(row.job, begin),
                                                           MakeTaskId(row.job, end - 1), begin < unarchived));
    for (pb::TaskInfo& task : *page.mutable_tasks()) {
      const bool is_meant = name.empty() ? task.state() == pb::TASK_STATE_FAILED : task.name() == name;
      if (is_meant) return task;
      if (begin == 0 && first.name().empty()) first = std::move(task);
    }
  }
  if (name.empty()) return first;
  return NotFoundError("job " + std::to_string(row.job) + " has no task '" + name + "'");
}

}  // namespace

Result<pb::GetJobReply> DescribePastJob(JobStore& store, const pb::GetJobRequest& request,
                                        size_t page_bytes) {
  RG_ASSIGN_OR_RETURN(const JobRow row, store.FindJob(request.job()));
  pb::GetJobReply reply;
  if (request.first_task() == 0) {
    RG_ASSIGN_OR_RETURN(reply, Overview(store, row));
  } else {
    *reply.mutable_job() = SummaryOf(row);
  }
  if (request.with_tasks() || request.with_attempts())
    RG_RETURN_IF_ERROR(AddTasks(store, row, request, page_bytes, &reply));
  return reply;
}

Result<pb::ExplainReply> ExplainPastTask(JobStore& store, const pb::ExplainRequest& request) {
  RG_ASSIGN_OR_RETURN(const JobRow row, store.FindJob(request.job()));
  RG_ASSIGN_OR_RETURN(const pb::TaskInfo task, TaskOfInterest(store, row, request.task()));
  pb::ExplainReply reply;
  reply.set_task(task.name());
  reply.set_state(task.state());
  reply.set_placeable(true);
  const std::string why = row.record.reason.empty() ? "" : ": " + row.record.reason;
  reply.add_reasons(task.state() == pb::TASK_STATE_SUCCEEDED ? "it is done"
                    : task.state() == pb::TASK_STATE_FAILED  ? "it failed" + why
                                                             : "it was cancelled" + why);
  return reply;
}

Result<ArchivedPart> ArchivePart(JobStore& store, JobId job, int64_t wall_ns) {
  RG_ASSIGN_OR_RETURN(const JobRow row, store.FindJob(job));
  RG_ASSIGN_OR_RETURN(const uint32_t begin, store.FirstUnarchived(job));
  if (begin == 0) {
    RG_ASSIGN_OR_RETURN(const pb::GetJobReply overview, Overview(store, row));
    RG_RETURN_IF_ERROR(store.BeginArchive(job, overview.SerializeAsString()));
  }
  const uint32_t end = std::min(row.total, begin + kTogether);
  if (begin < end) {
    const TaskId first = MakeTaskId(job, begin), last = MakeTaskId(job, end - 1);
    RG_ASSIGN_OR_RETURN(const pb::GetJobReply page, ReadThousand(store, first, last, false));
    RG_RETURN_IF_ERROR(store.Archive(first, last, page.SerializeAsString()));
  }
  if (end == row.total) RG_RETURN_IF_ERROR(store.EndArchive(job, wall_ns));
  return ArchivedPart{end - begin, end == row.total};
}

}  // namespace rg::coordinator
