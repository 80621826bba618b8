// The zero of a torque sensor or of a drive that is off.
//
//   tau = u + o        o [N·m]
#pragma once

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct TorqueOffset {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kRipple;

  static EffectInfo Info() {
    return {
        .id = "torque_offset",
        .title = "Torque offset",
        .stage = Stage::kActuator,
        .scope = Scope::kJoint,
        .equation = "tau = u + o",
        .sentence = "{joint} gets {offset} more torque than its effort says.",
        .parameters = {{"offset", "o", "N*m", "N", -kInf, kInf, 0, 0.03, true, false,
                        "delivered minus commanded torque"}},
        .family = "load",
        .confused_with = {"asymmetric_friction", "gravity_misalignment", "encoder_offset", "position_spring",
                          "payload", "parameters_only"},
        .reference = "",
        .shows_over = Variable::kEffort,
        .options = {},
        .needs = {Need::kBothWays},
    };
  }

  static Inference Inferred() {
    return {.terms = {{Regressor::kConstant, {"offset"}}},
            // Its sign is that of an effort, which nobody says here.
            .of_strength = [](double, double, const JointSize&) -> Values {
              return {{"offset", 0.0}};
            },
            // A dead band whose effort keeps its sign, a tilt and a wrong zero are constant forces, too.
            .rare = 2.0,
            .may_be_constant = true,
            .for_many_bodies = true};
  }

  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    law.drive += p[0];
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
