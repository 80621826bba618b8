// The drive delivers a multiple of the torque it is asked for.
//
//   tau = g·u        g [–], nominal 1
#pragma once

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct TorqueGain {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kGain;

  static EffectInfo Info() {
    return {
        .id = "torque_gain",
        .title = "Torque gain",
        .stage = Stage::kActuator,
        .scope = Scope::kJoint,
        .equation = "tau = g*u",
        .sentence = "{joint} delivers {gain} times the torque it is asked for.",
        .parameters = {{"gain", "g", "-", "-", -kInf, kInf, 1, 0.2, false, false,
                        "delivered per commanded torque"}},
        .family = "load",
        .confused_with = {"parameters_only", "payload", "gravity_misalignment", "load_dependent_friction"},
        .reference = "",
        .shows_over = Variable::kEffort,
        .options = {},
        .needs = {Need::kEffort},
    };
  }

  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    law.drive *= p[0];
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
