// What a diagnosis and its fits read: all recordings of one robot as one set, and the model to start from.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "common/recordings/recording_set.h"
#include "common/sim/model_file.h"
#include "worker/task_registry.h"

namespace rg::diagnosis {
struct Candidate;
}

namespace rg::jobs {

// All inputs named "recording". `rollouts`: they are the rollouts of a loop (rollout_inputs.h); what was left out is a
// warning of the set, and from three on every third is held out, never the newest. Else all count, or there is no set.
Result<recordings::RecordingSet> SetToDiagnose(const worker::TaskInput& input, bool rollouts);

// The input named "model", which the diagnosis starts from; nothing: from the set's URDF. In a loop
// (`rollouts`) it is the identified model, of which the effects count, with their values: its base parameters
// have absorbed what it lacks, and are the URDF's again.
Result<std::optional<sim::ModelFile>> ModelToDiagnose(const worker::TaskInput& input, bool rollouts);

// The input named "diagnosed", the last diagnosis of a loop, as the hypothesis to begin with; null: none, or it found
// nothing.
Result<std::shared_ptr<const diagnosis::Candidate>> EarlierDiagnosis(const worker::TaskInput& input);

// Joints of which the set's recordings cannot show viscous friction or a rotor's inertia: they hardly moved.
std::vector<std::string> QuietJoints(const recordings::RecordingSet& set, const sim::Plant& plant);

}  // namespace rg::jobs
