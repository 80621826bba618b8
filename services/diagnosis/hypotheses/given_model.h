// What a diagnosis starts from: the set's URDF as it is, or a model that was identified or augmented before.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "common/recordings/recording_set.h"
#include "common/sim/model_file.h"
#include "services/diagnosis/likelihood/candidate.h"

namespace rg::diagnosis {

// A plant whose nominal values, of base parameters and effects alike, are the model's, and in which rotors
// that the URDF cannot tell have inertias to start from (sysid/rotor_start.h). kInvalid: its joints are not
// those of the recordings.
Result<sim::Plant> GivenPlant(const recordings::RecordingSet& set,
                              const std::optional<sim::ModelFile>& model);

// Whether what was given, from which `given` was made, can be simulated.
bool GivenRuns(const sim::Plant& given, const std::optional<sim::ModelFile>& model);

// Its effects, each on one joint or on the robot as a whole, as hypotheses are.
std::vector<effects::EffectSpec> GivenEffects(const sim::Plant& given);

// These without those of which the recordings show nothing, as fits of all of them say.
std::vector<effects::EffectSpec> SeenEffects(
    const sim::Plant& given, const std::function<Candidate(const std::vector<effects::EffectSpec>&)>& fitted);

// Those of `specs` that the given model has not.
std::vector<effects::EffectSpec> Beyond(const sim::Plant& given,
                                        const std::vector<effects::EffectSpec>& specs);

}  // namespace rg::diagnosis
