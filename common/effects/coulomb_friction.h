// Coulomb friction with true sticking.
//
//   tau_f = −c·sign(v) while sliding;  any value in [−c, c] that keeps v = 0 at rest       c [N·m] ≥ 0
//
// See JointLaw::SignForce for reversals and rest. Dissipative. No state.
#pragma once

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct CoulombFriction {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kJoint;
  static constexpr bool kFriction = true;  // writes friction levels

  static EffectInfo Info() {
    return {
        .id = "coulomb_friction",
        .title = "Coulomb friction",
        .stage = Stage::kJoint,
        .scope = Scope::kJoint,
        .equation = "tau_f = -c*sign(dq)",
        .sentence =
            "{joint} loses a constant torque against its motion that the model does not have: Coulomb "
            "friction of {coulomb}.",
        .parameters = {{"coulomb", "c", "N*m", "N", 0, kInf, 0, 0.1, true, false, "Coulomb level"}},
        .family = "friction",
        .confused_with = {"viscous_friction", "stribeck_friction", "asymmetric_friction",
                          "load_dependent_friction", "presliding_hysteresis", "thermal_drift"},
        .reference = "Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994",
        .options = {},
        .needs = {Need::kBothWays},
    };
  }

  static Inference Inferred() {
    return {.terms = {{Regressor::kDirection, {"coulomb"}, true}},
            .of_every_drive = true,
            .slot = Slot::kDryFriction,
            .probe = Probe::kSpeeds,
            .of_strength = [](double level, double, const JointSize&) -> Values {
              return {{"coulomb", level}};
            }};
  }

  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    law.level_positive += p[0];
    law.level_negative += p[0];
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
