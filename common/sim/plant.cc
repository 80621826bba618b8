#include "common/sim/plant.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "common/base/check.h"
#include "common/dynamics/dynamics.h"
#include "common/effects/effect_catalog.h"
#include "common/integrators/step_kernel.h"
#include "common/sim/plant_builder.h"
#include "common/sim/plant_data.h"

namespace rg::sim {

Result<Plant> Plant::Create(std::shared_ptr<const model::RobotModel> model, const PlantOptions& options,
                            std::vector<effects::EffectSpec> effects) {
  RG_CHECK(model != nullptr);
  internal::PlantBuilder builder(std::move(model), options, std::move(effects));
  RG_RETURN_IF_ERROR(builder.Build());
  return Plant(builder.Take());
}

const model::RobotModel& Plant::model() const { return *data_->model; }
std::shared_ptr<const model::RobotModel> Plant::shared_model() const { return data_->model; }
const PlantOptions& Plant::options() const { return data_->options; }
const std::vector<effects::EffectSpec>& Plant::effects() const { return data_->effects; }
const ParameterTable& Plant::parameters() const { return data_->table; }
int Plant::num_joints() const { return data_->num_joints(); }
int Plant::num_internal_states() const { return data_->num_internal_states(); }
const std::vector<std::string>& Plant::joint_names() const { return data_->joint_names; }
const std::vector<int>& Plant::prescribed() const { return data_->prescribed; }
bool Plant::IsPrescribed(int joint) const { return data_->IsPrescribed(joint); }
bool Plant::IsPassive(int joint) const { return data_->passive[static_cast<size_t>(joint)] != 0; }
bool Plant::Takes(std::string_view effect, int joint) const {
  return data_->Takes(*effects::FindEffect(effect), joint);
}
const std::vector<std::string>& Plant::internal_state_names() const { return data_->internal_state_names; }

Result<Plant> Plant::WithEffect(effects::EffectSpec effect) const {
  auto all = data_->effects;
  all.push_back(std::move(effect));
  return Create(data_->model, data_->options, std::move(all));
}

Result<Plant> Plant::WithRoles(std::vector<std::string> prescribed, std::vector<std::string> passive) const {
  PlantOptions options = data_->options;
  options.prescribed = std::move(prescribed), options.passive = std::move(passive);
  return Create(data_->model, options, data_->effects);
}

Plant Plant::WithoutEffect(const std::string& id) const {
  auto all = data_->effects;
  std::erase_if(all, [&](const effects::EffectSpec& spec) { return spec.id == id; });
  return Create(data_->model, data_->options, std::move(all)).value();
}

Eigen::VectorXd Plant::ValuesFrom(const ParameterTable& other, const Eigen::VectorXd& values) const {
  RG_CHECK(values.size() == other.size());
  Eigen::VectorXd mine = parameters().Nominal();
  for (int i = 0; i < parameters().size(); ++i) {
    const int j = other.Find(parameters()[i].name);
    if (j >= 0) mine[i] = values[j];
  }
  return mine;
}

std::vector<int> PaperParameters(const Plant& plant) {
  const ParameterTable& table = plant.parameters();
  std::vector<int> indices = table.OfKind(ParameterKind::kGravity);
  for (const ParameterKind kind :
       {ParameterKind::kMass, ParameterKind::kDamping, ParameterKind::kForceGain}) {
    for (const int i : table.OfKind(kind)) indices.push_back(i);
  }
  for (const int i : table.OfKind(ParameterKind::kInertia)) {
    const std::string& field = table[i].field;
    if (field == "inertia_xx" || field == "inertia_yy" || field == "inertia_zz") indices.push_back(i);
  }
  return indices;
}

}  // namespace rg::sim
