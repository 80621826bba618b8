#include "services/jobs/diagnosis_inputs.h"

#include <algorithm>
#include <utility>

#include "common/effects/inference.h"
#include "services/diagnosis/hypotheses/given_model.h"
#include "services/diagnosis/reporting/set_check.h"
#include "services/jobs/kinds.h"
#include "services/jobs/rollout_inputs.h"
#include "services/rollouts/recording_bundle.h"

namespace rg::jobs {

namespace {

// From three rollouts on every third is held out, oldest first, never the newest.
void HoldOut(recordings::RecordingSet* set) {
  const size_t count = set->recordings.size();
  for (size_t i = 0; i < count; ++i) {
    const bool out = count > 2 && i % 3 == 0 && i + 1 < count;
    set->recordings[i].split = out ? recordings::Split::kHoldout : recordings::Split::kFit;
  }
}

// That of a user: all of it counts.
Result<std::vector<recordings::RecordingSet>> AllSetsOf(const worker::TaskInput& input) {
  std::vector<recordings::RecordingSet> sets;
  for (const worker::InputArtifact* artifact : input.All(kInputRecording)) {
    auto set = rg::rollouts::LoadBundle(artifact->bytes);
    if (!set.ok()) return set.status().WithPrefix("recording set " + artifact->sha256.substr(0, 12));
    sets.push_back(std::move(*set));
  }
  return sets;
}

}  // namespace

Result<recordings::RecordingSet> SetToDiagnose(const worker::TaskInput& input, bool rollouts) {
  RG_RETURN_IF_ERROR(input.Require(kInputRecording).status());
  ReadRollouts read;
  if (rollouts) {
    RG_ASSIGN_OR_RETURN(read, RolloutsOf(input, rg::rollouts::LoadBundle));
  } else {
    RG_ASSIGN_OR_RETURN(read.sets, AllSetsOf(input));
  }
  for (size_t i = 0; i < read.sets.size(); ++i) read.sets[i].folder = "set" + std::to_string(i + 1);
  RG_ASSIGN_OR_RETURN(recordings::RecordingSet all, recordings::MergeSets(std::move(read.sets)));
  all.warnings.insert(all.warnings.end(), read.left_out.begin(), read.left_out.end());
  if (rollouts) HoldOut(&all);
  return all;
}

Result<std::optional<sim::ModelFile>> ModelToDiagnose(const worker::TaskInput& input, bool rollouts) {
  const worker::InputArtifact* artifact = input.Find(kInputModel);
  if (artifact == nullptr) return std::optional<sim::ModelFile>();
  RG_ASSIGN_OR_RETURN(sim::ModelFile model,
                      sim::ModelFromJson(artifact->bytes, "model " + artifact->sha256.substr(0, 12)));
  const sim::ParameterTable& table = model.plant.parameters();
  for (int i = 0; rollouts && i < table.size(); ++i) {
    if (table[i].kind != sim::ParameterKind::kEffect) model.values[i] = table[i].nominal;
  }
  return std::optional<sim::ModelFile>(std::move(model));
}

Result<std::shared_ptr<const diagnosis::Candidate>> EarlierDiagnosis(const worker::TaskInput& input) {
  const worker::InputArtifact* artifact = input.Find(kInputDiagnosed);
  if (artifact == nullptr) return std::shared_ptr<const diagnosis::Candidate>();
  RG_ASSIGN_OR_RETURN(const sim::ModelFile model,
                      sim::ModelFromJson(artifact->bytes, "diagnosed " + artifact->sha256.substr(0, 12)));
  if (model.plant.effects().empty()) return std::shared_ptr<const diagnosis::Candidate>();
  return std::shared_ptr<const diagnosis::Candidate>(
      std::make_shared<diagnosis::Candidate>(diagnosis::HypothesisOf(model)));
}

std::vector<std::string> QuietJoints(const recordings::RecordingSet& set, const sim::Plant& plant) {
  const auto check = diagnosis::CheckSet(set, plant, true);
  if (!check.ok()) return plant.joint_names();
  const std::vector<diagnosis::EffectShows> effects = diagnosis::WhatShows(check->survey, plant);
  const std::string &damping = effects::LawOf(effects::Regressor::kVelocity).id,
                    &rotor = effects::LawOf(effects::Regressor::kAcceleration).id;
  std::vector<std::string> quiet;
  for (const std::string& joint : plant.joint_names()) {
    const auto hidden = [&](const diagnosis::EffectShows& effect) {
      return (effect.effect == damping || effect.effect == rotor) &&
             std::count(effect.joints.begin(), effect.joints.end(), joint) == 0;
    };
    if (std::any_of(effects.begin(), effects.end(), hidden)) quiet.push_back(joint);
  }
  return quiet;
}

}  // namespace rg::jobs
