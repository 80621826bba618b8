// What people see of the state: summaries, stages, progress, estimates.
#pragma once

#include <string>

#include "common/base/status.h"
#include "coordinator/core/state.h"
#include "coordinator/store/job_store.h"
#include "realitygrad/v1/control.pb.h"
#include "realitygrad/v1/job.pb.h"
#include "realitygrad/v1/worker.pb.h"

namespace rg::coordinator {

namespace pb = realitygrad::v1;

// Weight of what running tasks have done so far, per job.
std::map<JobId, double> WeightUnderWay(const State& state);

// From its rows alone, of a job that is not in memory.
pb::JobSummary SummaryOf(const JobRow& row);
void FillTask(TaskId id, const TaskPlan& plan, const TaskRecord& record, const TaskRows& rows,
              pb::TaskInfo* out);
pb::JobSummary SummaryOf(const Job& job, double weight_under_way, int64_t wall_ns);
pb::WorkerInfo InfoOf(const Worker& worker, const State& state, int64_t steady_ns);
void FillStages(const State& state, const Job& job, pb::GetJobReply* reply);
// From task `first` on, until the reply has about `max_bytes`; the next page is in reply->next_task().
Status FillTasks(const State& state, const Job& job, bool with_attempts, uint32_t first, size_t max_bytes,
                 JobStore& store, pb::GetJobReply* reply);
// Index of the task of that name; -1: none.
int64_t FindTask(const Job& job, const std::string& name);

}  // namespace rg::coordinator
