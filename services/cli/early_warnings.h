// What is to be known of a recording set before any search, said on stderr first by every command that
// searches.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "common/recordings/recording_set.h"
#include "common/sim/model_file.h"

namespace rg::cli {

class Context;

// "note: …" per warning, those of `realitygrad check`, which are returned. The error is the check's refusal.
// `model`: what a search would start from; none: the set's URDF.
Result<std::vector<std::string>> SayWarnings(const Context& context, const recordings::RecordingSet& set,
                                             const std::optional<sim::ModelFile>& model, bool trust_effort);

}  // namespace rg::cli
