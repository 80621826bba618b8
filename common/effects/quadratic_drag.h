// Drag that grows with the square of the speed.
//
//   tau_f = −b·v·|v|        b [N·m·s²/rad²] ≥ 0
//
// Dissipative. No state.
#pragma once

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct QuadraticDrag {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kJoint;

  static EffectInfo Info() {
    return {
        .id = "quadratic_drag",
        .title = "Quadratic drag",
        .stage = Stage::kJoint,
        .scope = Scope::kJoint,
        .equation = "tau_f = -b*dq*abs(dq)",
        .sentence =
            "{joint} loses a torque with the square of its speed that the model does not have: drag of "
            "{quadratic}.",
        .parameters = {{"quadratic", "b", "N*m*s^2/rad^2", "N*s^2/m^2", 0, kInf, 0, 0.1, true, false,
                        "drag coefficient"}},
        .family = "friction",
        .confused_with = {"viscous_friction"},
        .reference = "",
        .options = {},
        .needs = {Need::kManySpeeds},
    };
  }

  static Inference Inferred() {
    return {.terms = {{Regressor::kSquaredVelocity, {"quadratic"}, true}}, .probe = Probe::kSpeeds};
  }

  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    law.quadratic += p[0];
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
