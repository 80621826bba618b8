// From the coefficients of a balance of torques to effects as the simulator has them.
#include <algorithm>
#include <cmath>

#include "services/diagnosis/balance_selection.h"
#include "services/diagnosis/hypotheses.h"

namespace rg::diagnosis {

using effects::EffectSpec;

namespace {

constexpr double kLeastLevel = 1e-3;  // of the joint's usual torque: a friction that starts at 0 stays there

double ShapeOf(const TorqueBalance& balance, const BalanceModel& m, const std::string& effect, int joint) {
  for (const int c : m.features[joint]) {
    if (balance.columns[joint][c].effect == effect) return balance.columns[joint][c].shape;
  }
  return 1.0;
}

}  // namespace

// u = (rigid + friction)/g: every coefficient but the gain's own is of the effort's scale.
double BalanceSelection::Scale(const BalanceSolution& s, int joint) const {
  return std::clamp(1.0 / std::max(0.1, 1.0 - Coefficient(s, "torque_gain", joint)), 0.05, 8.0);
}

std::vector<EffectSpec> BalanceSelection::SpecsOfJoint(const BalanceModel& m, const BalanceSolution& s,
                                                       int j) const {
  std::vector<EffectSpec> specs;
  const std::string& joint = nominal_.joint_names()[j];
  const auto add = [&](const std::string& id, std::map<std::string, double> values) {
    specs.push_back(effects::MakeSpec(id, {joint}, std::move(values)));
  };
  const double gain = Scale(s, j);
  const auto value = [&](const std::string& effect) { return gain * Coefficient(s, effect, j); };
  const double level = value("coulomb_friction"), offset = value("torque_offset"),
               small = kLeastLevel * scales_.torque[j];
  for (const auto& [id, name] : {std::pair<std::string, std::string>{"viscous_friction", "viscous"},
                                 {"rotor_inertia", "armature"},
                                 {"quadratic_drag", "quadratic"}}) {
    if (Has(m, id, j)) add(id, {{name, std::max(0.0, value(id))}});
  }
  if (Has(m, "torque_gain", j)) add("torque_gain", {{"gain", gain}});
  const bool spring = Has(m, "position_spring", j);
  if (spring) {
    const double k = value("position_spring"), middle = 0.5 * (scales_.low[j] + scales_.high[j]);
    const double range = scales_.high[j] - scales_.low[j];
    const double center = std::clamp(middle + offset / k, middle - 10 * range, middle + 10 * range);
    add("position_spring",
        {{"stiffness", k}, {"cubic", 0.0}, {"center", std::isfinite(center) ? center : middle}});
  }
  if (Has(m, "stribeck_friction", j)) {
    add("stribeck_friction", {{"coulomb", std::max(small, level)},
                              {"static", std::max(small, level + value("stribeck_friction"))},
                              {"stribeck_velocity", ShapeOf(balance_, m, "stribeck_friction", j)}});
  } else if (Has(m, "load_dependent_friction", j)) {
    add("load_dependent_friction",
        {{"coulomb", std::max(small, level)},
         {"load_coefficient", std::max(0.0, Coefficient(s, "load_dependent_friction", j))}});
  } else if (Has(m, "thermal_drift", j)) {
    add("thermal_drift", {{"initial", std::max(small, level + value("thermal_drift"))},
                          {"final", std::max(small, level)},
                          {"time_constant", ShapeOf(balance_, m, "thermal_drift", j)}});
  } else if (Has(m, "coulomb_friction", j)) {
    add("coulomb_friction", {{"coulomb", std::max(small, level)}});
  }
  if (Has(m, "torque_ripple", j)) {
    const auto of = [&](const char* role) {
      double sum = 0;
      for (const int c : m.features[j]) {
        const BalanceColumn& column = balance_.columns[j][c];
        if (column.effect == "torque_ripple" && column.role == role)
          sum += gain * s.features[j][c] * column.scale;
      }
      return sum;
    };
    add("torque_ripple", {{"amplitude", std::hypot(of("sin"), of("cos"))},
                          {"cycles_per_rev", ShapeOf(balance_, m, "torque_ripple", j)},
                          {"phase", std::atan2(of("cos"), of("sin"))}});
  }
  if (Has(m, "torque_offset", j) && !spring) add("torque_offset", {{"offset", offset}});
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
    const bool delay = timing.kind == EffortTiming::kDelay;
    specs.push_back(effects::MakeSpec(delay ? "actuator_delay" : "actuator_lag", {nominal_.joint_names()[j]},
                                      {{delay ? "delay" : "time_constant", timing.seconds}}));
  }
  if (const auto payload = PayloadOf(m)) specs.push_back(*payload);
  if (!m.drive.empty()) {
    const BalanceDrive& drive = fit_.drive();
    const double gain = Scale(s, drive.joint);
    const auto value = [&](int c) { return std::max(0.0, gain * s.drive[c] * drive.scale[c]); };
    const auto& names = nominal_.joint_names();
    specs.push_back(effects::MakeSpec("joint_coupling", {names[drive.other], names[drive.joint]},
                                      {{"coefficient", drive.ratio},
                                       {"viscous", value(BalanceDrive::kViscous)},
                                       {"coulomb", value(BalanceDrive::kCoulomb)},
                                       {"armature", value(BalanceDrive::kRotor)}}));
    specs.back().options["form"] = "kinematic";
  }
  if (m.tilt) {
    const double gx = kTiltPrior * s.base[balance_.tilt], gy = kTiltPrior * s.base[balance_.tilt + 1];
    const double g = std::max(1e-6, nominal_.options().gravity.norm());
    specs.push_back(effects::MakeSpec(
        "gravity_misalignment", {},
        {{"tilt", std::clamp(std::hypot(gx, gy) / g, 1e-3, 1.2)}, {"azimuth", std::atan2(gy, gx)}}));
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
    const auto of = [&](const std::string& effect) {
      double variance = 0;
      for (const int c : ColumnsOf(effect, j)) {
        if (model_.features[j].count(c))
          variance += std::pow(spread.features[j][c] * balance_.columns[j][c].scale, 2);
      }
      return variance;
    };
    const double level = of("coulomb_friction"), offset = of("torque_offset");
    const double timing = timing_[j].seconds > 0 ? timing_[j].stddev * timing_[j].stddev : 0.0;
    const std::map<std::string, double> variances = {
        {"viscous_friction.viscous", of("viscous_friction")},
        {"quadratic_drag.quadratic", of("quadratic_drag")},
        {"rotor_inertia.armature", of("rotor_inertia")},
        {"torque_gain.gain", of("torque_gain")},
        {"position_spring.stiffness", of("position_spring")},
        {"coulomb_friction.coulomb", level},
        {"torque_offset.offset", offset},
        {"stribeck_friction.coulomb", level},
        {"stribeck_friction.static", level + of("stribeck_friction")},
        {"load_dependent_friction.coulomb", level},
        {"load_dependent_friction.load_coefficient", of("load_dependent_friction")},
        {"thermal_drift.initial", level + of("thermal_drift")},
        {"thermal_drift.final", level},
        {"actuator_delay.delay", timing},
        {"actuator_lag.time_constant", timing}};
    for (const auto& [name, variance] : variances) {
      if (variance <= 0) continue;
      const size_t dot = name.find('.');
      out[name.substr(0, dot) + "." + nominal_.joint_names()[j] + name.substr(dot)] = std::sqrt(variance);
    }
  }
  if (!model_.drive.empty()) {
    const char* const names[] = {"viscous", "coulomb", "armature"};
    for (const int c : model_.drive)
      out[std::string("joint_coupling.*.") + names[c]] = spread.drive[c] * fit_.drive().scale[c];
    out["joint_coupling.*.coefficient"] = ratio_stddev_;
  }
  return out;
}

}  // namespace rg::diagnosis
