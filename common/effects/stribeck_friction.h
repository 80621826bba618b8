// Stribeck friction: the level falls from a static to a Coulomb value as the joint starts to slide.
//
//   tau_f = −(c + (s − c)·exp(−(v/v_s)²))·sign(v)      c, s [N·m] ≥ 0, v_s [rad/s] > 0, usually s ≥ c
//
// The falling branch acts like negative damping −k, k ≈ 0.86·(s−c)/v_s. Where a step cannot resolve it
// (h·k against the inertia) the level is taken nearer to the step's begin, so that the step keeps one
// solution; otherwise at the mean speed, second order. Dissipative. No state.
#pragma once

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct StribeckFriction {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kJoint;
  static constexpr bool kFriction = true;  // writes friction levels

  static EffectInfo Info() {
    return {
        .id = "stribeck_friction",
        .title = "Stribeck friction",
        .stage = Stage::kJoint,
        .scope = Scope::kJoint,
        .equation = "tau_f = -(c + (s-c)*exp(-(dq/v_s)^2))*sign(dq)",
        .sentence =
            "{joint} needs {static} to break loose and {coulomb} to keep sliding, which the model does not "
            "have: Stribeck friction, falling over {stribeck_velocity}.",
        .parameters = {{"coulomb", "c", "N*m", "N", 0, kInf, 0, 0.1, true, false, "level while sliding"},
                       {"static", "s", "N*m", "N", 0, kInf, 0, 0.15, true, false, "level at rest"},
                       {"stribeck_velocity", "v_s", "rad/s", "m/s", 1e-6, kInf, 0.05, 0.05, false, false,
                        "speed over which the level falls"}},
        .family = "friction",
        .confused_with = {"viscous_friction", "coulomb_friction", "asymmetric_friction",
                          "load_dependent_friction", "presliding_hysteresis", "thermal_drift"},
        .reference = "Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994",
        .options = {},
        .needs = {Need::kBothWays, Need::kSlowMotion, Need::kDenseRows},
    };
  }

  static Inference Inferred() {
    return {.terms = {{Regressor::kDirection, {"coulomb", "static"}, true}, {Regressor::kSlowly, {"static"}}},
            .shape = "stribeck_velocity",
            .slot = Slot::kDryFriction,
            .probe = Probe::kSlowRamps,
            .of_strength = [](double level, double, const JointSize& joint) -> Values {
              return {{"coulomb", 0.9 * level},
                      {"static", 1.2 * level},
                      {"stribeck_velocity", 0.2 * joint.speed}};
            },
            .prior = [](const std::string& field, double nominal, const EffectSpec&,
                        const JointSize& joint) -> std::optional<Prior> {
              if (field != "stribeck_velocity") return {};
              return Prior{nominal, 0.5 * joint.speed, 0.02 * joint.speed, 3 * joint.speed};
            },
            // A level that grows with speed is drag.
            .plausible = [](const std::vector<double>& c) { return c[1] > 0; }};
  }

  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    using T = Base<S>;
    const S drop = p[1] - p[0];
    // 0.86 is the largest slope of exp(−x²); the weight keeps h·k·w below a quarter of the inertia.
    const T k = T(0.86) * Abs(Value(drop)) / Value(p[2]);
    const T x = T(2) * law.step.h * k / law.reference_mass;
    const T w = T(0.5) / Select(x > T(1), x, T(1));
    const S speed = Abs(law.v0) + w * (Abs(law.v1) - Abs(law.v0));
    const S r = speed / p[2];
    const S level = p[0] + drop * Exp(-(r * r));
    law.level_positive += level;
    law.level_negative += level;
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
