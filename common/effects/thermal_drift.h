// Friction that decays as the joint warms up.
//
//   tau_f = −c(t)·sign(v),   c(t) = c_∞ + (c₀ − c_∞)·exp(−t/T)       c₀, c_∞ [N·m] ≥ 0, T [s] > 0
//
// t is the state's time: the recording's, so windows of one recording share one decay. Dissipative.
#pragma once

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct ThermalDrift {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kJoint;
  static constexpr bool kFriction = true;  // writes friction levels

  static EffectInfo Info() {
    return {
        .id = "thermal_drift",
        .title = "Thermal drift of friction",
        .stage = Stage::kJoint,
        .scope = Scope::kJoint,
        .equation = "tau_f = -(c_inf + (c_0-c_inf)*exp(-t/T))*sign(dq)",
        .sentence =
            "{joint}'s friction starts at {initial} and settles at {final} within about {time_constant}.",
        .parameters = {{"initial", "c_0", "N*m", "N", 0, kInf, 0, 0.1, true, false, "level at the start"},
                       {"final", "c_inf", "N*m", "N", 0, kInf, 0, 0.1, true, false, "level after warming up"},
                       {"time_constant", "T", "s", "s", 1e-3, kInf, 10, 10, false, false,
                        "time constant of the decay"}},
        .family = "friction",
        .confused_with = {"viscous_friction", "coulomb_friction", "stribeck_friction", "asymmetric_friction",
                          "load_dependent_friction", "presliding_hysteresis"},
        .reference = "",
        .options = {},
        .needs = {Need::kBothWays, Need::kWarming},
    };
  }

  static Inference Inferred() {
    return {
        .terms = {{Regressor::kDirection, {"initial", "final"}, true}, {Regressor::kWarmingUp, {"initial"}}},
        .shape = "time_constant",
        .slot = Slot::kDryFriction,
        .probe = Probe::kRepeats,
        .of_strength = [](double level, double, const JointSize& joint) -> Values {
          return {{"initial", 1.1 * level}, {"final", 0.9 * level}, {"time_constant", 0.4 * joint.duration}};
        },
        .prior = [](const std::string& field, double nominal, const EffectSpec&,
                    const JointSize& joint) -> std::optional<Prior> {
          if (field != "time_constant") return {};
          return Prior{nominal, 0.5 * joint.duration, 0.03 * joint.duration, 4 * joint.duration};
        },
        .plausible = [](const std::vector<double>& c) { return c[0] + c[1] > 0; }};
  }

  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    using T = Base<S>;
    const T t = law.step.t + T(0.5) * law.step.h;
    const S level = p[1] + (p[0] - p[1]) * Exp((-t) / p[2]);
    law.level_positive += level;
    law.level_negative += level;
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
