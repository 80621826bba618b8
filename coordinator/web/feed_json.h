// What only the page is told, as JSON values (the rest: coordinator/client/as_json.h). Pure; no I/O.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "realitygrad/v1/artifact.pb.h"
#include "realitygrad/v1/control.pb.h"

namespace rg::coordinator::web {

nlohmann::json StatusJson(const realitygrad::v1::StatusReply& status, int64_t wall_ns);
// A whole number of seconds while it is away: the page is drawn again where it changes.
nlohmann::json SeenWorkerJson(const realitygrad::v1::WorkerInfo& worker);
// What the page shows of a diagnosis' file (realitygrad.diagnosis/1).
nlohmann::json DiagnosisJson(const std::string& bytes, const realitygrad::v1::ArtifactInfo& info);

}  // namespace rg::coordinator::web
