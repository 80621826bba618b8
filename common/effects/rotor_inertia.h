// Inertia of the motor's rotor as the link feels it through the gear (armature).
//
//   tau = −J·q̈        J [kg·m²] ≥ 0        the gyroscopic part of a spinning rotor is left out
//
// Adds to the diagonal of the mass matrix. Conservative. No state.
#pragma once

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct RotorInertia {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kJoint;
  static constexpr int kInertiaParameter = 0;  // this parameter is law.inertia

  static EffectInfo Info() {
    return {
        .id = "rotor_inertia",
        .title = "Rotor inertia",
        .stage = Stage::kJoint,
        .scope = Scope::kJoint,
        .equation = "tau = -J*ddq",
        .sentence = "{joint} is more inert than its links: a reflected rotor inertia of {armature}.",
        .parameters = {{"armature", "J", "kg*m^2", "kg", 0, kInf, 0, 0.1, false, false, "reflected inertia"}},
        .family = "inertia",
        .confused_with = {"parameters_only", "payload", "torque_gain"},
        .reference = "Featherstone, Rigid Body Dynamics Algorithms, 2008, section 9.6",
        .options = {},
        .of_drive = true,
        .needs = {Need::kAcceleration},
    };
  }

  static Inference Inferred() {
    return {.terms = {{Regressor::kAcceleration, {"armature"}, true}},
            .of_every_drive = true,
            .probe = Probe::kReversals,
            .for_many_bodies = true};
  }

  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    law.inertia += p[0];
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
