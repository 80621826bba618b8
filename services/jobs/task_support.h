// Shared by the task kinds: payloads and inputs read with errors that name them.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

#include "common/base/status.h"
#include "common/sim/model_file.h"
#include "worker/task_registry.h"

namespace rg::jobs {

template <class Payload>
Result<Payload> ParsePayload(const worker::TaskInput& input) {
  Payload payload;
  if (!payload.ParseFromString(input.payload)) {
    return InvalidError(input.task_name + ": the payload is no " +
                        std::string(Payload::descriptor()->name()));
  }
  return payload;
}

// The input `model` as a plant with values.
Result<sim::ModelFile> ModelOf(const worker::TaskInput& input);

// What the task that made the artefact said of it; an object, empty where it said nothing.
nlohmann::json MetadataOf(const worker::InputArtifact& artifact);

}  // namespace rg::jobs
