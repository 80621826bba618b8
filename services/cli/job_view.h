// How jobs, stages and workers look: as tables, and as progress while one waits.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "coordinator/client/as_json.h"
#include "services/cli/output.h"

namespace rg::coordinator {
class Client;
}

namespace rg::cli {

class Context;

using coordinator::JobStateText, coordinator::TaskStateText, coordinator::WhoOf;
std::string TimeText(int64_t wall_ns);  // "–" for 0

std::string JobsTable(const std::vector<realitygrad::v1::JobSummary>& jobs);
std::string JobDetails(const realitygrad::v1::GetJobReply& job, bool with_tasks);
std::string WorkersTable(const std::vector<realitygrad::v1::WorkerInfo>& workers);

// Waits for a job and shows its stages one after another on stderr. Returns the job's end.
// timeout_s < 0: for ever.
Result<realitygrad::v1::GetJobReply> FollowJob(coordinator::Client& client, int64_t job, double timeout_s,
                                               bool quiet);

}  // namespace rg::cli
