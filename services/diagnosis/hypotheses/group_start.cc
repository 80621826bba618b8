#include "services/diagnosis/hypotheses/group_start.h"

#include <algorithm>
#include <cmath>

#include "common/effects/effect_catalog.h"
#include "common/effects/inference.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/sysid/fit_space.h"
#include "services/sysid/initial_regression.h"

namespace rg::diagnosis {

namespace {

constexpr double kLeastStart = 0.02;  // of the prior stddev: a strength of zero has no gradient in its shape

// The effect on each joint that takes it and does not have it.
std::vector<EffectSpec> OnEveryJoint(const sim::Plant& nominal, const std::string& id) {
  std::vector<EffectSpec> out;
  for (int j = 0; j < nominal.num_joints(); ++j) {
    const std::string& joint = nominal.joint_names()[j];
    if (!nominal.Takes(id, j) || Contains(nominal.effects(), id, joint)) continue;
    // Not where it would replace an effect of the given model.
    const EffectSpec spec = effects::MakeSpec(id, {joint});
    if (Joined(nominal.effects(), {spec}).size() == nominal.effects().size() + 1) out.push_back(spec);
  }
  return out;
}

// Effect parameters within their bounds, strengths not zero.
VectorXd Startable(const sim::Plant& plant, const std::vector<sysid::FitParameter>& parameters,
                   VectorXd values) {
  for (const sysid::FitParameter& p : parameters) {
    if (plant.parameters()[p.index].kind != sim::ParameterKind::kEffect) continue;
    double& value = values[p.index];
    if (p.lower >= 0) value = std::max(value, kLeastStart * p.prior_stddev);
    value = std::clamp(value, p.lower, p.upper);
  }
  return values;
}

// A regression's fit. `torque_stddev`: of what it leaves, by joint; `coefficients`: of the further columns.
struct Regression {
  Candidate fitted;
  VectorXd torque_stddev, coefficients;
};
Regression Regressed(const FitSetting& setting, const std::vector<std::string>& effects, bool base,
                     const std::vector<sysid::RegressionColumn>& further = {}) {
  const sim::Plant& nominal = setting.nominal;
  Regression out;
  Candidate& c = out.fitted;
  c.base = base, c.specs = nominal.effects();
  for (const std::string& id : effects) {
    const std::vector<EffectSpec> more = OnEveryJoint(nominal, id);
    c.specs.insert(c.specs.end(), more.begin(), more.end());
  }
  const auto plant = sim::Plant::Create(nominal.shared_model(), nominal.options(), c.specs);
  if (!plant.ok()) return out;
  c.plant = std::make_shared<const sim::Plant>(*plant);
  c.parameters = FreeParameters(*c.plant, setting.scales, base, &nominal);
  const sysid::FitSpace space(c.parameters);
  const VectorXd start = c.plant->ValuesFrom(nominal.parameters(), nominal.parameters().Nominal());
  const auto found = sysid::RegressInverseDynamics(*c.plant, start, space, space.From(start),
                                                   setting.data.recordings, {}, further);
  c.fit.ok = found.rows > 0 && found.theta.allFinite();
  if (!c.fit.ok) return out;
  out.torque_stddev = found.torque_stddev, out.coefficients = found.coefficients;
  c.fit.theta = found.theta;
  c.fit.values = Startable(*c.plant, c.parameters, space.Values(found.theta, start));
  c.fit.chi2 = effects::kInf;  // not of the simulator
  c.fit.rows = setting.data.Rows();
  c.specs = Refreshed(c);
  return out;
}

// Whether it is a law of which `LawsOnAll` asks.
bool IsLinearLaw(const effects::EffectInfo& effect) {
  const effects::Inference& own = effects::InferenceOf(effect.id);
  return effect.scope == effects::Scope::kJoint && !own.terms.empty() && !own.unnamed &&
         own.slot != effects::Slot::kDryFriction &&
         std::ranges::all_of(own.terms, [](const effects::Term& t) {
           return sysid::RegressionColumnOf(t.regressor, 1, 1, 1).has_value();
         });
}

std::vector<sysid::RegressionColumn> ColumnsOf(const effects::EffectInfo& law, int joint,
                                               const MotionScales& scales) {
  std::vector<sysid::RegressionColumn> out;
  for (const effects::Term& t : effects::InferenceOf(law.id).terms) {
    const double typical =
        std::abs(*sysid::RegressionColumnOf(t.regressor, 0.5 * (scales.high[joint] - scales.low[joint]),
                                            scales.speed[joint], scales.acceleration[joint]));
    out.push_back({joint, t.regressor, 0.5 * (scales.low[joint] + scales.high[joint]),
                   scales.torque[joint] / std::max(1e-6, typical)});
  }
  return out;
}

}  // namespace

Candidate RegressedGroup(const FitSetting& setting, const std::vector<std::string>& effects, bool base) {
  return Regressed(setting, effects, base).fitted;
}

VectorXd LeftByGroup(const FitSetting& setting, const std::vector<std::string>& effects) {
  const Regression without = Regressed(setting, {}, true);
  const Regression with = Regressed(setting, effects, true);
  if (!without.fitted.fit.ok || !with.fitted.fit.ok) return VectorXd::Ones(setting.data.n);
  return with.torque_stddev.cwiseQuotient(without.torque_stddev);
}

std::vector<LawOnAll> LawsOnAll(const FitSetting& setting, const std::vector<std::string>& losses, bool base,
                                double most) {
  const auto& [data, nominal, scales] = setting;
  // Springs on all joints act like masses that are off: what is beside free inertials counts.
  const Regression without = Regressed(setting, losses, true);
  std::vector<LawOnAll> out;
  if (!without.fitted.fit.ok) return out;
  for (const effects::EffectInfo& law : effects::Catalog()) {
    if (!IsLinearLaw(law) || std::ranges::count(losses, law.id) > 0) continue;
    Scored scored;
    scored.effect = law.id;
    std::vector<sysid::RegressionColumn> columns;
    for (int j = 0; j < data.n; ++j) {
      const std::string& joint = nominal.joint_names()[j];
      if (!data.Judged(j) || !nominal.Takes(law.id, j) || Contains(nominal.effects(), law.id, joint))
        continue;
      const auto own = ColumnsOf(law, j, scales);
      columns.insert(columns.end(), own.begin(), own.end());
      scored.joints.push_back(j);
    }
    if (scored.joints.size() < 2) continue;
    const Regression freed = Regressed(setting, losses, true, columns);
    if (!freed.fitted.fit.ok) continue;
    LawOnAll found{freed.torque_stddev.cwiseQuotient(without.torque_stddev), {}};
    const auto helped = std::ranges::count_if(scored.joints, [&](int j) { return found.left[j] < most; });
    if (2 * helped < data.judged()) continue;
    const Regression with = base ? freed : Regressed(setting, losses, false, columns);
    if (!with.fitted.fit.ok || !with.coefficients.allFinite()) continue;
    const size_t terms = columns.size() / scored.joints.size();
    for (size_t i = 0; i < scored.joints.size(); ++i) {
      Scored one = scored;
      one.joints = {scored.joints[i]}, one.shape = columns[i * terms].shape;
      const VectorXd c = with.coefficients.segment(static_cast<long>(i * terms), static_cast<long>(terms));
      one.coefficients.assign(c.begin(), c.end());
      const auto specs = SpecsFor(one, nominal, scales);
      found.specs.insert(found.specs.end(), specs[0].begin(), specs[0].end());
    }
    out.push_back(std::move(found));
  }
  std::ranges::stable_sort(out,
                           [](const LawOnAll& a, const LawOnAll& b) { return a.left.sum() < b.left.sum(); });
  return out;
}

}  // namespace rg::diagnosis
