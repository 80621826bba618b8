#include "services/diagnosis/hypotheses/group_start.h"

#include <algorithm>

#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/sysid/fit_space.h"
#include "services/sysid/initial_regression.h"

namespace rg::diagnosis {

using effects::EffectSpec;
using Eigen::VectorXd;

namespace {

constexpr double kLeastStart = 0.02;  // of the prior stddev: a strength of zero has no gradient in its shape

// The effect on each joint that takes it and does not have it.
std::vector<EffectSpec> OnEveryJoint(const sim::Plant& nominal, const std::string& id) {
  std::vector<EffectSpec> out;
  for (int j = 0; j < nominal.num_joints(); ++j) {
    const std::string& joint = nominal.joint_names()[static_cast<size_t>(j)];
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

// `torque_stddev`: n, of the residual torque.
Candidate Regressed(const FitData& data, const sim::Plant& nominal, const MotionScales& scales,
                    const std::vector<std::string>& effects, bool base, VectorXd* torque_stddev) {
  Candidate c;
  c.base = base, c.specs = nominal.effects();
  for (const std::string& id : effects) {
    const std::vector<EffectSpec> more = OnEveryJoint(nominal, id);
    c.specs.insert(c.specs.end(), more.begin(), more.end());
  }
  const auto plant = sim::Plant::Create(nominal.shared_model(), nominal.options(), c.specs);
  if (!plant.ok()) return c;
  c.plant = std::make_shared<const sim::Plant>(*plant);
  c.parameters = FreeParameters(*c.plant, scales, base);
  const sysid::FitSpace space(c.parameters);
  const VectorXd start = c.plant->ValuesFrom(nominal.parameters(), nominal.parameters().Nominal());
  VectorXd theta = space.nominal();
  for (int i = 0; i < space.size(); ++i) {
    if (space.IsItself(i)) theta[i] = start[c.parameters[static_cast<size_t>(i)].index];
  }
  theta = theta.cwiseMax(space.lower()).cwiseMin(space.upper());
  const auto found = sysid::RegressInverseDynamics(*c.plant, start, space, theta, data.recordings);
  c.fit.ok = found.rows > 0 && found.theta.allFinite();
  if (!c.fit.ok) return c;
  *torque_stddev = found.torque_stddev;
  c.fit.theta = found.theta;
  c.fit.values = Startable(*c.plant, c.parameters, space.Values(found.theta, start));
  c.fit.chi2 = effects::kInf;  // not of the simulator
  c.fit.rows = data.Rows();
  c.specs = Refreshed(c);
  return c;
}

}  // namespace

Candidate RegressedGroup(const FitData& data, const sim::Plant& nominal, const MotionScales& scales,
                         const std::vector<std::string>& effects, bool base) {
  VectorXd left;
  return Regressed(data, nominal, scales, effects, base, &left);
}

VectorXd LeftByGroup(const FitData& data, const sim::Plant& nominal, const MotionScales& scales,
                     const std::vector<std::string>& effects) {
  VectorXd without, with;
  const bool ok = Regressed(data, nominal, scales, {}, true, &without).fit.ok &&
                  Regressed(data, nominal, scales, effects, true, &with).fit.ok;
  return ok ? VectorXd(with.cwiseQuotient(without)) : VectorXd(VectorXd::Ones(data.n));
}

}  // namespace rg::diagnosis
