// Viscous friction: a torque against the motion, in proportion to speed.
//
//   tau_f = −d·v        d [N·m·s/rad] ≥ 0
//
// Smooth in v and d; dissipative for d ≥ 0. No state. Adds to the damping that the URDF declares.
#pragma once

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct ViscousFriction {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kJoint;

  static EffectInfo Info() {
    return {
        .id = "viscous_friction",
        .title = "Viscous friction",
        .stage = Stage::kJoint,
        .scope = Scope::kJoint,
        .equation = "tau_f = -d*dq",
        .sentence =
            "{joint} loses a torque in proportion to its speed that the model does not have: viscous "
            "friction of {viscous}.",
        .parameters = {{"viscous", "d", "N*m*s/rad", "N*s/m", 0, kInf, 0, 0.1, true, false,
                        "viscous coefficient"}},
        .family = "friction",
        .confused_with = {"coulomb_friction", "stribeck_friction", "asymmetric_friction",
                          "load_dependent_friction", "presliding_hysteresis", "thermal_drift",
                          "quadratic_drag"},
        .reference = "Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994",
        .options = {},
        .needs = {Need::kManySpeeds},
    };
  }

  static Inference Inferred() {
    return {.terms = {{Regressor::kVelocity, {"viscous"}, true}},
            .of_every_drive = true,
            .probe = Probe::kSpeeds,
            .of_strength = [](double level, double, const JointSize& joint) -> Values {
              return {{"viscous", level / joint.speed}};
            }};
  }

  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    law.viscous += p[0];
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
