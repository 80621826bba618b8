// How jobs, stages and workers look: as tables, as JSON, and as progress while one waits.
#pragma once

#include <functional>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "services/cli/output.h"

namespace realitygrad::v1 {
class GetJobReply;
class JobSummary;
class WorkerInfo;
}  // namespace realitygrad::v1

namespace rg::coordinator {
class Client;
}

namespace rg::cli {

class Context;

std::string JobStateText(int state);
std::string TaskStateText(int state);
std::string TimeText(int64_t wall_ns);  // "–" for 0

// JobSummary.submitted_by in its parts: "anna (anna@lab7)".
struct Who {
  std::string name, remark;
};
Who WhoOf(const std::string& submitted_by);

nlohmann::json JobJson(const realitygrad::v1::JobSummary& job);
nlohmann::json JobDetailsJson(const realitygrad::v1::GetJobReply& job);
std::string JobsTable(const std::vector<realitygrad::v1::JobSummary>& jobs);
std::string JobDetails(const realitygrad::v1::GetJobReply& job, bool with_tasks);
nlohmann::json WorkerJson(const realitygrad::v1::WorkerInfo& worker);
std::string WorkersTable(const std::vector<realitygrad::v1::WorkerInfo>& workers);

// Waits for a job and shows its stages one after another on stderr. Returns the job's end.
// timeout_s < 0: for ever.
Result<realitygrad::v1::GetJobReply> FollowJob(coordinator::Client& client, int64_t job, double timeout_s,
                                               bool quiet);

}  // namespace rg::cli
