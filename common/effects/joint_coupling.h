// Torque of one joint's drive that reaches another joint (wrist gears, belts, tendons).
//
//   tau_j += κ·tau_i,   joints listed as i, j;  tau_i after the actuator stage        κ [–]
#pragma once

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct JointCoupling {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kCoupling;

  static EffectInfo Info() {
    return {
        .id = "joint_coupling",
        .title = "Coupled joints",
        .stage = Stage::kTransmission,
        .scope = Scope::kJointPair,
        .equation = "tau_j += kappa*tau_i",
        .sentence = "{coefficient} times the torque of the first joint of {joint} reaches the second.",
        .parameters = {{"coefficient", "kappa", "-", "-", -kInf, kInf, 0, 0.1, false, false,
                        "share that reaches the second joint"}},
        .family = "coupling",
        .confused_with = {"unknown_field", "torque_gain"},
        .reference = "",
        .shows_over = Variable::kEffort,
        .options = {},
        .needs = {Need::kOtherEffort},
    };
  }

  // On the program of joint j; law.coupled is tau_i.
  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    law.drive += p[0] * law.coupled;
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
