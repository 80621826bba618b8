// The model that a diagnosis starts from: the set's URDF, or a model identified or augmented before.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "common/recordings/recording_set.h"
#include "common/sim/model_file.h"
#include "services/diagnosis/likelihood/candidate.h"

namespace rg::diagnosis {

// A plant with the model's values (base parameters and effects) as nominal ones, and with start values for
// rotor inertias that the URDF does not declare (sysid/rotor_start.h). kInvalid: its joints are not those of
// the recordings.
Result<sim::Plant> GivenPlant(const recordings::RecordingSet& set,
                              const std::optional<sim::ModelFile>& model);

// Whether what was given, from which `given` was made, can be simulated.
bool GivenRuns(const sim::Plant& given, const std::optional<sim::ModelFile>& model);

// Its effects in the form of hypotheses: one spec per joint, or one for the whole robot.
std::vector<EffectSpec> GivenEffects(const sim::Plant& given);

// An earlier model of the same robot as a hypothesis to begin a search with (DiagnosisOptions::earlier): its effects
// with their values, its base parameters as free ones.
Candidate HypothesisOf(const sim::ModelFile& model);

// These without those that the recordings do not inform, by repeated fits of the rest.
std::vector<EffectSpec> SeenEffects(const sim::Plant& given,
                                    const std::function<Candidate(const std::vector<EffectSpec>&)>& fitted);

// Those of `specs` that the given model does not have.
std::vector<EffectSpec> Beyond(const sim::Plant& given, const std::vector<EffectSpec>& specs);

}  // namespace rg::diagnosis
