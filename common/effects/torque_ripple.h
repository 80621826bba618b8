// Torque that varies with position: cogging, gear mesh, torque-sensor ripple.
//
//   tau = u + a·sin(n·q + φ)        a [N·m], n [cycles per revolution], φ [rad]
//
// For a prismatic joint n counts cycles per 2π m.
#pragma once

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct TorqueRipple {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kRipple;

  static EffectInfo Info() {
    return {
        .id = "torque_ripple",
        .title = "Torque ripple",
        .stage = Stage::kActuator,
        .scope = Scope::kJoint,
        .equation = "tau = u + a*sin(n*q + phi)",
        .sentence = "{joint}'s torque varies by {amplitude}, {cycles_per_rev} times per turn.",
        .parameters = {{"amplitude", "a", "N*m", "N", 0, kInf, 0, 0.03, true, false, "amplitude"},
                       {"cycles_per_rev", "n", "-", "rad/m", 0, kInf, 1, 10, false, false,
                        "cycles per revolution"},
                       {"phase", "phi", "rad", "rad", -kInf, kInf, 0, 3, false, false, "phase at q = 0"}},
        .family = "position",
        .confused_with = {"position_spring", "unknown_field"},
        .reference = "",
        .shows_over = Variable::kPosition,
        .options = {},
        .needs = {Need::kPeriods},
    };
  }

  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    using T = Base<S>;
    law.drive += p[0] * Sin(p[1] * law.PositionAt(S(T(0.5))) + p[2]);
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
