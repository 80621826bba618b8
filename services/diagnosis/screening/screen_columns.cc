#include "services/diagnosis/screening/screen_columns.h"

#include <optional>
#include <utility>

#include "common/effects/effect_catalog.h"
#include "common/effects/inference.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/likelihood/candidate.h"
#include "services/diagnosis/likelihood/fitted_motion.h"
#include "services/diagnosis/likelihood/screen.h"

namespace rg::diagnosis {

namespace {

constexpr int kNullDraws = 60;         // of the null distribution
constexpr double kGravityPrior = 0.6;  // m/s², prior stddev of gravity's x and y

// An error of a sensor: a parameter of the model, not a force.
bool IsOfSensor(const std::string& id) {
  const int kind = effects::KindOf(id);
  if (kind < 0) return false;
  const effects::Role role = effects::TraitsOf(kind).role;
  return role == effects::Role::kSensorOffset || role == effects::Role::kSensorDelay;
}

}  // namespace

std::vector<EffectSpec> WithProbes(const std::vector<EffectSpec>& held, const sim::Plant& plant) {
  std::vector<EffectSpec> out = held;
  for (int j = 0; j < plant.num_joints(); ++j) {
    const std::string& joint = plant.joint_names()[j];
    for (const effects::EffectInfo& probe : effects::Catalog()) {
      if (IsOfSensor(probe.id) && plant.Takes(probe.id, j) && !Contains(held, probe.id, joint))
        out.push_back(effects::MakeSpec(probe.id, {joint}));
    }
  }
  return out;
}

std::vector<ParameterColumn> ScreenColumns(const sim::Plant& plant, const sim::Plant& nominal,
                                           const MotionScales& scales, const std::vector<EffectSpec>& held,
                                           std::vector<sysid::FitParameter>* parameters) {
  *parameters = FreeParameters(plant, scales, true, &nominal);
  std::vector<ParameterColumn> columns;
  const auto has = [&](const std::string& id, const std::string& joint) { return Contains(held, id, joint); };
  const std::string &payload = effects::EffectOf(effects::Role::kBodyInertia).id,
                    &tilt = effects::EffectOf(effects::Role::kGravity).id;
  const auto& model = plant.model();
  const std::string& last = model.link(model.joint(model.num_joints() - 1).child_link).name;
  for (const auto& p : *parameters) {
    const sim::Parameter& row = plant.parameters()[p.index];
    ParameterColumn c;
    c.prior_stddev = p.prior_stddev;
    c.base = row.kind != sim::ParameterKind::kEffect && row.kind != sim::ParameterKind::kArmature;
    // With one joint a payload and its link are the same.
    c.last_link = c.base && row.owner == last && model.num_joints() > 1 && !has(payload, "");
    if (c.last_link) c.role = row.field;
    if (IsOfSensor(row.effect) && !has(row.effect, row.owner))
      c.effect = row.effect, c.role = row.field, c.joint = model.FindJoint(row.owner);
    columns.push_back(c);
  }
  if (!has(tilt, "")) {
    for (const char* axis : {"gravity.x", "gravity.y"}) {
      const int at = plant.parameters().Find(axis);
      sysid::FitParameter p{at, axis, "m/s^2", plant.parameters()[at].nominal, -20, 20, kGravityPrior};
      parameters->push_back(p);
      columns.push_back({tilt, axis, -1, kGravityPrior, false});
    }
  }
  return columns;
}

FeatureSet FeaturesAlongFit(const FitSetting& setting, const Candidate& fitted, const LiftedOptions& options,
                            double* work) {
  const FitModel model{*fitted.plant, fitted.fit.values, {}};
  if (work != nullptr) *work += SimulationWork(setting.data, options, fitted.plant->num_states());
  return MakeFeatures(setting.data, setting.nominal, setting.scales,
                      FittedMotions(setting.data, model, fitted.fit.states, options));
}

namespace {

// What a screen around a model is linearised in, and at.
struct ScreenedModel {
  FitModel model;
  std::vector<ParameterColumn> columns;
  NodeStates states;
};

std::optional<ScreenedModel> ModelAround(const FitSetting& setting, const Candidate& current,
                                         const ScreenPoint& at, const LiftedOptions& options) {
  const sim::Plant& nominal = setting.nominal;
  const std::vector<EffectSpec> own = Refreshed(current);
  auto plant = sim::Plant::Create(nominal.shared_model(), nominal.options(), WithProbes(own, nominal));
  if (!plant.ok()) return std::nullopt;
  std::vector<sysid::FitParameter> parameters;
  auto columns = ScreenColumns(*plant, nominal, setting.scales, own, &parameters);
  const Candidate* from = at.around_fit ? &current : at.values_of;
  VectorXd values = plant->parameters().Nominal();
  if (from != nullptr) values = plant->ValuesFrom(from->plant->parameters(), from->fit.values);
  for (size_t c = 0; c < columns.size(); ++c) {
    const sysid::FitParameter& p = parameters[c];
    if (columns[c].effect.empty()) columns[c].away = (values[p.index] - p.nominal) / p.prior_stddev;
  }
  FitModel model{*plant, values, parameters};
  const bool as_fitted = at.around_fit && current.fit.states.front().rows() == plant->num_states();
  NodeStates states = as_fitted ? current.fit.states : InitialStates(setting.data, model, options);
  return ScreenedModel{std::move(model), std::move(columns), std::move(states)};
}

}  // namespace

ScreenResult ScreenAround(const FitSetting& setting, const Candidate& current, const ScreenPoint& at,
                          const FeatureSet& features, const LiftedOptions& options, Rng rng,
                          std::vector<VectorXd>* step_rule) {
  const auto around = ModelAround(setting, current, at, options);
  if (!around) return {};
  if (step_rule != nullptr && step_rule->empty())
    *step_rule = StepRuleResiduals(setting.data, around->model, around->states, options);
  const Screen screen =
      MakeScreen(setting.data, around->model, around->states, features.block, options,
                 step_rule == nullptr ? std::vector<VectorXd>{} : *step_rule, kNullDraws, rng);
  return ScoreHypotheses(screen, around->columns, features, current.base, setting.nominal);
}

std::vector<ScreenResult> ScreensBeside(const FreeForce& force, const FitSetting& setting,
                                        const Candidate& current, const ScreenPoint& at,
                                        const FeatureSet& features, const LiftedOptions& options, Rng rng) {
  const auto around = ModelAround(setting, current, at, options);
  std::vector<ScreenResult> out;
  if (!around) return out;
  for (const Screen& screen : MakeScreens(force, setting.data, around->model, around->states, features.block,
                                          options, kNullDraws, rng))
    out.push_back(ScoreHypotheses(screen, around->columns, features, current.base, setting.nominal));
  return out;
}

}  // namespace rg::diagnosis
