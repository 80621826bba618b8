// Coulomb friction whose level depends on the direction of motion.
//
//   tau_f = −c₊ for v > 0,  +c₋ for v < 0,  anything between at rest        c₊, c₋ [N·m] ≥ 0
//
// Dissipative. No state.
#pragma once

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct AsymmetricFriction {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kJoint;
  static constexpr bool kFriction = true;  // writes friction levels

  static EffectInfo Info() {
    return {
        .id = "asymmetric_friction",
        .title = "Direction-dependent friction",
        .stage = Stage::kJoint,
        .scope = Scope::kJoint,
        .equation = "tau_f = -c_p for dq > 0, +c_n for dq < 0",
        .sentence =
            "{joint} loses {coulomb_positive} when it turns forward and {coulomb_negative} when it turns "
            "back: friction that depends on the direction.",
        .parameters = {{"coulomb_positive", "c_p", "N*m", "N", 0, kInf, 0, 0.1, true, false,
                        "level for positive velocity"},
                       {"coulomb_negative", "c_n", "N*m", "N", 0, kInf, 0, 0.1, true, false,
                        "level for negative velocity"}},
        .family = "friction",
        .confused_with = {"viscous_friction", "coulomb_friction", "stribeck_friction",
                          "load_dependent_friction", "presliding_hysteresis", "thermal_drift"},
        .reference = "Janot, Gautier et al., EMPS, IFAC 2017",
        .options = {},
        .needs = {Need::kBothWays},
    };
  }

  static Inference Inferred() {
    return {.terms = {{Regressor::kForwards, {"coulomb_positive"}, true},
                      {Regressor::kBackwards, {"coulomb_negative"}, true}},
            .slot = Slot::kDryFriction,
            .probe = Probe::kSpeeds,
            .of_strength = [](double level, double, const JointSize&) -> Values {
              return {{"coulomb_positive", level}, {"coulomb_negative", level}};
            }};
  }

  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    law.level_positive += p[0];
    law.level_negative += p[1];
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
