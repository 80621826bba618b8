// Jobs that have left memory, as their rows or their archive tell. On any connection, from its thread.
#pragma once

#include "common/base/status.h"
#include "coordinator/store/job_store.h"
#include "realitygrad/v1/control.pb.h"

namespace rg::coordinator {

namespace pb = realitygrad::v1;

// request.job() names it. kNotFound.
Result<pb::GetJobReply> DescribePastJob(JobStore& store, const pb::GetJobRequest& request, size_t page_bytes);
Result<pb::ExplainReply> ExplainPastTask(JobStore& store, const pb::ExplainRequest& request);

// The first thousand tasks of the job that are not archived yet go there, in the open transaction. How many
// did; the job is archived when these were the last.
struct ArchivedPart {
  uint32_t tasks = 0;
  bool done = false;
};
Result<ArchivedPart> ArchivePart(JobStore& store, JobId job, int64_t wall_ns);

}  // namespace rg::coordinator
