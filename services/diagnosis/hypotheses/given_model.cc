#include "services/diagnosis/hypotheses/given_model.h"

#include <algorithm>

#include "common/effects/effect_catalog.h"
#include "common/model/robot_model.h"
#include "services/sysid/rotor_start.h"
#include "services/sysid/sysid_on_set.h"

namespace rg::diagnosis {

namespace {

bool ActsOnJointsTogether(const EffectSpec& spec) {
  return effects::FindEffect(spec.id)->scope == effects::Scope::kJointPair;
}

// Effects with the values that the model has for them now.
std::vector<EffectSpec> EffectsOf(const sim::ModelFile& model) {
  std::vector<EffectSpec> specs = model.plant.effects();
  const sim::ParameterTable& table = model.plant.parameters();
  for (EffectSpec& spec : specs) {
    for (int i = 0; i < table.size(); ++i) {
      const sim::Parameter& p = table[i];
      const bool own = p.effect == spec.id &&
                       (p.owner == "*" || std::ranges::find(spec.joints, p.owner) != spec.joints.end());
      if (own) spec.values[p.owner][p.field] = std::clamp(model.values[i], p.lower, p.upper);
    }
  }
  return specs;
}

// One spec per joint, or one for the whole robot.
std::vector<EffectSpec> Apart(const std::vector<EffectSpec>& specs) {
  std::vector<EffectSpec> out;
  for (const EffectSpec& spec : specs) {
    if (spec.joints.size() < 2 || ActsOnJointsTogether(spec)) {
      out.push_back(spec);
      continue;
    }
    for (const std::string& joint : spec.joints) {
      EffectSpec one = spec;
      one.joints = {joint};
      std::erase_if(one.values, [&](const auto& row) { return row.first != joint && row.first != "*"; });
      out.push_back(std::move(one));
    }
  }
  return out;
}

}  // namespace

Result<sim::Plant> GivenPlant(const recordings::RecordingSet& set,
                              const std::optional<sim::ModelFile>& model) {
  RG_ASSIGN_OR_RETURN(sim::Plant urdf, sysid::NominalPlant(set));
  if (!model) return sysid::WithRotors(set, urdf, urdf.parameters().Nominal());
  RG_RETURN_IF_ERROR(sysid::CheckJoints(model->plant, urdf));
  sim::PlantOptions options = model->plant.options();
  options.prescribed = urdf.options().prescribed, options.passive = urdf.options().passive;
  const sim::ParameterTable& table = model->plant.parameters();
  for (int i = 0; i < table.size(); ++i) {
    if (table[i].kind == sim::ParameterKind::kEffect) continue;
    if (model->values[i] != table[i].nominal) options.nominal[table[i].name] = model->values[i];
  }
  RG_ASSIGN_OR_RETURN(const sim::Plant given,
                      sim::Plant::Create(model->plant.shared_model(), options, EffectsOf(*model)));
  return sysid::WithRotors(set, given, given.parameters().Nominal());
}

bool GivenRuns(const sim::Plant& given, const std::optional<sim::ModelFile>& model) {
  if (model) return sysid::Runs(model->plant, model->values);
  const auto& without = given.model().joints_without_inertia();
  return std::ranges::all_of(without, [&](int j) { return given.IsPrescribed(j); });
}

std::vector<EffectSpec> GivenEffects(const sim::Plant& given) { return Apart(given.effects()); }

Candidate HypothesisOf(const sim::ModelFile& model) {
  Candidate c;
  c.specs = Apart(EffectsOf(model));
  c.base = true;
  c.plant = std::make_shared<const sim::Plant>(model.plant);
  c.fit.values = model.values;
  c.fit.ok = true;
  return c;
}

std::vector<EffectSpec> SeenEffects(const sim::Plant& given,
                                    const std::function<Candidate(const std::vector<EffectSpec>&)>& fitted) {
  std::vector<EffectSpec> effects = GivenEffects(given);
  for (bool changed = !effects.empty(); changed;) {
    const Candidate c = fitted(effects);
    std::vector<EffectSpec> seen;
    if (c.fit.theta.size() == 0) return {};  // it cannot be fitted: start without effects
    for (size_t i = 0; i < effects.size(); ++i) {
      if (c.fit.ok || !Uninformed(c, i)) seen.push_back(effects[i]);
    }
    changed = seen.size() < effects.size();
    effects = std::move(seen);
  }
  return effects;
}

std::vector<EffectSpec> Beyond(const sim::Plant& given, const std::vector<EffectSpec>& specs) {
  std::vector<EffectSpec> out;
  for (const EffectSpec& spec : specs) {
    const std::string joint = spec.joints.empty() ? "" : spec.joints.front();
    if (!Contains(given.effects(), spec.id, joint)) out.push_back(spec);
  }
  return out;
}

}  // namespace rg::diagnosis
