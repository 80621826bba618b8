// Converts coefficients of the balance of torques to effects of the simulator.
#include <algorithm>
#include <cmath>

#include "common/effects/effect_catalog.h"
#include "services/diagnosis/balance/balance_selection.h"
#include "services/diagnosis/hypotheses/hypotheses.h"

namespace rg::diagnosis {

using effects::Regressor;

namespace {

constexpr double kLeastLevel = 1e-3;  // of the joint's usual torque: start value of a friction, at least

// Laws in the order in which effects are read off a model: a refined law before the plain one whose term it
// includes.
constexpr Regressor kReadingOrder[] = {
    Regressor::kVelocity,  Regressor::kAcceleration, Regressor::kSquaredVelocity, Regressor::kEffort,
    Regressor::kPosition,  Regressor::kSlowly,       Regressor::kUnderLoad,       Regressor::kWarmingUp,
    Regressor::kDirection, Regressor::kSine,         Regressor::kConstant};

// The terms of the law's effect that no plainer law has. (A ripple has two, of which one may be absent.)
std::vector<Regressor> OwnTerms(Regressor law) {
  const std::string& effect = effects::LawOf(law).id;
  std::vector<Regressor> out;
  for (const effects::Term& t : effects::InferenceOf(effect).terms) {
    if (effects::LawOf(t.regressor).id == effect) out.push_back(t.regressor);
  }
  return out;
}

const effects::EffectInfo& EffectOf(EffortTiming timing) {
  return effects::LawOf(timing == EffortTiming::kDelay ? Regressor::kDelayed : Regressor::kLagging);
}

}  // namespace

// u = (rigid + friction)/g: coefficients other than the gain are in units of the effort.
double BalanceSelection::Scale(const BalanceSolution& s, int joint) const {
  return std::clamp(1.0 / std::max(0.1, 1.0 - Coefficient(s, Regressor::kEffort, joint)), 0.05, 8.0);
}

// The effect of a law, from its terms' coefficients.
EffectSpec BalanceSelection::SpecOf(Regressor law, const BalanceModel& m, const BalanceSolution& s,
                                    int j) const {
  const effects::EffectInfo& effect = effects::LawOf(law);
  const std::vector<std::string> joint = {nominal_.joint_names()[j]};
  const double gain = Scale(s, j), middle = 0.5 * (scales_.low[j] + scales_.high[j]),
               range = scales_.high[j] - scales_.low[j];
  if (law == Regressor::kEffort)
    return effects::MakeSpec(effect.id, joint, {{effect.parameters[0].name, gain}});
  std::vector<double> c = Coefficients(s, effects::InferenceOf(effect.id), j);
  // A share of the torque has no unit.
  for (double& x : c) x *= &x == &c.back() && law == Regressor::kUnderLoad ? 1.0 : gain;
  effects::Found found{c};
  const std::vector<Regressor> own = OwnTerms(law);
  for (const int column : m.features[j]) {
    const BalanceColumn& of = balance_.columns[j][column];
    if (std::ranges::find(own, of.regressor) != own.end()) found.shape = of.shape;
  }
  found.joint = SizeOf(scales_, nominal_, j);
  found.least = 0, found.least_share = kLeastLevel;
  found.low = middle - 10 * range, found.high = middle + 10 * range;
  return effects::MakeSpec(effect.id, joint, effects::StartsOf(effect, found).front().values);
}

std::vector<EffectSpec> BalanceSelection::SpecsOfJoint(const BalanceModel& m, const BalanceSolution& s,
                                                       int j) const {
  std::vector<EffectSpec> specs;
  std::set<Regressor> taken;
  for (const Regressor law : kReadingOrder) {
    const std::vector<Regressor> own = OwnTerms(law);
    const bool has = std::ranges::any_of(own, [&](Regressor r) { return Has(m, r, j); });
    if (!has || taken.count(law) > 0) continue;
    specs.push_back(SpecOf(law, m, s, j));
    for (const effects::Term& t : effects::InferenceOf(specs.back().id).terms) taken.insert(t.regressor);
  }
  std::erase_if(specs, [&](const EffectSpec& e) {
    const Status valid = effects::ValidateSpec(e);
    if (!valid.ok()) trace_("  left out: " + valid.ToString());
    return !valid.ok();
  });
  return specs;
}

std::vector<EffectSpec> BalanceSelection::SpecsOf(const BalanceModel& m) const {
  const BalanceSolution s = fit_.Solve(m);
  std::vector<EffectSpec> specs;
  for (int j = 0; j < data_.n; ++j) {
    for (EffectSpec& e : SpecsOfJoint(m, s, j)) specs.push_back(std::move(e));
    const JointTiming& timing = timing_[j];
    if (timing.seconds <= 0) continue;
    const effects::EffectInfo& late = EffectOf(timing.kind);
    specs.push_back(
        effects::MakeSpec(late.id, {nominal_.joint_names()[j]}, {{late.parameters[0].name, timing.seconds}}));
  }
  if (const auto payload = PayloadOf(m)) specs.push_back(*payload);
  if (!m.drive.empty()) {
    const BalanceDrive& drive = fit_.drive();
    const double gain = Scale(s, drive.joint);
    const auto value = [&](int c) { return std::max(0.0, gain * s.drive[c] * drive.scale[c]); };
    const auto& names = nominal_.joint_names();
    specs.push_back(CoupledDrive(
        names[drive.other], names[drive.joint], drive.ratio,
        {value(BalanceDrive::kViscous), value(BalanceDrive::kCoulomb), value(BalanceDrive::kRotor)}));
  }
  if (m.tilt) {
    Scored tilt;
    tilt.effect = effects::EffectOf(effects::Role::kGravity).id;
    for (const int axis : {0, 1}) tilt.coefficients.push_back(kTiltPrior * s.base[balance_.tilt + axis]);
    specs.push_back(SpecsFor(tilt, nominal_, scales_).front().front());
  }
  return specs;
}

std::set<std::string> BalanceSelection::KindsOf(const BalanceModel& m) const {
  std::set<std::string> out;
  for (const EffectSpec& s : SpecsOf(m)) out.insert(s.id);
  return out;
}

std::map<std::string, double> BalanceSelection::Spread() const {
  std::map<std::string, double> out;
  const BalanceSolution spread = fit_.Jackknife(model_);
  for (int j = 0; j < data_.n; ++j) {
    const std::string& joint = nominal_.joint_names()[j];
    const auto variance = [&](Regressor law) {
      double sum = 0;
      for (const int c : ColumnsOf(law, j)) {
        if (model_.features[j].count(c))
          sum += std::pow(spread.features[j][c] * balance_.columns[j][c].scale, 2);
      }
      return sum;
    };
    for (const effects::EffectInfo& effect : effects::Catalog()) {
      for (const effects::ParameterInfo& p : effect.parameters) {
        double sum = 0;
        for (const effects::Term& t : effects::InferenceOf(effect.id).terms) {
          if (std::ranges::count(t.adds_to, p.name) > 0) sum += variance(t.regressor);
        }
        if (sum > 0) out[effect.id + "." + joint + "." + p.name] = std::sqrt(sum);
      }
    }
    for (const EffortTiming timing : {EffortTiming::kDelay, EffortTiming::kLag}) {
      const effects::EffectInfo& late = EffectOf(timing);
      if (timing_[j].seconds > 0 && timing_[j].stddev > 0)
        out[late.id + "." + joint + "." + late.parameters[0].name] = timing_[j].stddev;
    }
  }
  if (!model_.drive.empty()) {
    const char* const names[] = {"viscous", "coulomb", "armature"};
    const std::string drive = effects::LawOf(Regressor::kOtherEffort).id + ".*.";
    for (const int c : model_.drive) out[drive + names[c]] = spread.drive[c] * fit_.drive().scale[c];
    out[drive + "coefficient"] = ratio_stddev_;
  }
  return out;
}

}  // namespace rg::diagnosis
