// What the page is told, as JSON values. Pure; no I/O.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "realitygrad/v1/artifact.pb.h"
#include "realitygrad/v1/control.pb.h"
#include "realitygrad/v1/parameters.pb.h"

namespace rg::coordinator::web {

nlohmann::json StatusJson(const realitygrad::v1::StatusReply& status, int64_t wall_ns);
nlohmann::json JobJson(const realitygrad::v1::JobSummary& job, int64_t wall_ns);
// With its stages and, as far as the reply has them, its tasks.
nlohmann::json JobDetailsJson(const realitygrad::v1::GetJobReply& reply, int64_t wall_ns);
// The smallest "best_cost" that tasks of the newest stage that has one said in their summaries; null: none
// did.
nlohmann::json BestResidual(const realitygrad::v1::GetJobReply& reply);
nlohmann::json WorkerJson(const realitygrad::v1::WorkerInfo& worker);
nlohmann::json LogLineJson(const realitygrad::v1::TaskLogLine& line);
nlohmann::json EventJson(const realitygrad::v1::EventRecord& event);
nlohmann::json ArtifactJson(const realitygrad::v1::ArtifactInfo& info);
nlohmann::json VersionJson(const realitygrad::v1::ParameterVersion& version);  // without its values
// What the page shows of a diagnosis' file (realitygrad.diagnosis/1).
nlohmann::json DiagnosisJson(const std::string& bytes, const realitygrad::v1::ArtifactInfo& info);

// Bytes that are no UTF-8 become '?'.
std::string Dump(const nlohmann::json& value);

}  // namespace rg::coordinator::web
