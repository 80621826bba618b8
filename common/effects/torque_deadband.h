// A drive that ignores small commands.
//
//   tau = 0 for |u| < δ,   u − δ·sign(u) beyond        δ [N·m] ≥ 0
#pragma once

#include <algorithm>

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct TorqueDeadband {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kDeadband;

  static EffectInfo Info() {
    return {
        .id = "torque_deadband",
        .title = "Torque dead band",
        .stage = Stage::kActuator,
        .scope = Scope::kJoint,
        .equation = "tau = 0 for abs(u) < delta, u - delta*sign(u) beyond",
        .sentence = "{joint} ignores commands below {deadband}.",
        .parameters = {{"deadband", "delta", "N*m", "N", 0, kInf, 0, 0.05, true, false,
                        "half width of the dead band"}},
        .family = "actuator",
        .confused_with = {"coulomb_friction"},
        .reference = "",
        .shows_over = Variable::kEffort,
        .options = {},
        .needs = {Need::kEffortSign},
    };
  }

  static Inference Inferred() {
    return {.terms = {{Regressor::kInBand, {}, true}},
            .coefficient = Inference::Near::kOneOrBelowFirst,  // a band that every effort exceeds
            .starts = [](const Found& f) -> std::vector<Start> {
              return {{{{"deadband", std::max(f.c[0] * f.shape, f.least)}}}};
            },
            .of_strength = [](double level, double, const JointSize&) -> Values {
              return {{"deadband", level}};
            },
            .may_be_constant = true};
  }

  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    using T = Base<S>;
    const S above = law.drive - p[0];
    const S below = law.drive + p[0];
    law.drive = Select(above > T(0), above, Select(below < T(0), below, S(T(0))));
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
