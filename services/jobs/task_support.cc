#include "services/jobs/task_support.h"

#include <nlohmann/json.hpp>

#include "services/jobs/kinds.h"

namespace rg::jobs {

Result<sim::ModelFile> ModelOf(const worker::TaskInput& input) {
  RG_ASSIGN_OR_RETURN(const worker::InputArtifact* model, input.Require(kInputModel));
  return sim::ModelFromJson(model->bytes, "model " + model->sha256.substr(0, 12));
}

nlohmann::json MetadataOf(const worker::InputArtifact& artifact) {
  nlohmann::json said = nlohmann::json::parse(artifact.metadata_json, nullptr, false);
  return said.is_object() ? said : nlohmann::json::object();
}

}  // namespace rg::jobs
