// What the coordinator answers, as JSON: the same for the command line and for the page. Pure; no I/O.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "common/base/clock.h"

namespace realitygrad::v1 {
class ArtifactInfo;
class EventRecord;
class GetJobReply;
class JobSummary;
class ParameterVersion;
class TaskInfo;
class TaskLogLine;
class WorkerInfo;
}  // namespace realitygrad::v1

namespace rg::coordinator {

std::string JobStateText(int state);                                         // "running"
// JobSummary.submitted_by in its parts: "anna (anna@lab7)".
struct Who {
  std::string name, remark;
};
Who WhoOf(const std::string& submitted_by);
std::string TaskStateText(int state);                                        // "leased"
nlohmann::json SecondsJson(int64_t from_ns, int64_t to_ns, int64_t now_ns);  // null: not begun

nlohmann::json JobJson(const realitygrad::v1::JobSummary& job, int64_t wall_ns = RealClock().WallNanos());
// With its stages and, as far as the reply has them, its tasks.
nlohmann::json JobDetailsJson(const realitygrad::v1::GetJobReply& reply, bool with_summaries,
                              int64_t wall_ns = RealClock().WallNanos());
// The smallest "best_cost" in the summaries of the newest stage that has one; NaN: none.
double BestResidual(const realitygrad::v1::GetJobReply& reply);
// Who runs it, or ran it last as far as the reply has attempts.
const std::string& WorkerOf(const realitygrad::v1::TaskInfo& task);
nlohmann::json WorkerJson(const realitygrad::v1::WorkerInfo& worker);
nlohmann::json LogLineJson(const realitygrad::v1::TaskLogLine& line);
nlohmann::json EventJson(const realitygrad::v1::EventRecord& event);
nlohmann::json ArtifactJson(const realitygrad::v1::ArtifactInfo& info);
std::string SourceText(int source);                                            // of a version: "identified"
nlohmann::json VersionJson(const realitygrad::v1::ParameterVersion& version);  // its values where it has them

// Bytes that are no UTF-8 become '?'.
std::string Dump(const nlohmann::json& value);

}  // namespace rg::coordinator
