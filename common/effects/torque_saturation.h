// A drive that cannot deliver more than a limit, lower than what the URDF says.
//
//   tau = clip(u, −tau_max, tau_max)        tau_max [N·m] > 0; default: the joint's effort limit
#pragma once

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct TorqueSaturation {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kSaturation;

  static EffectInfo Info() {
    return {
        .id = "torque_saturation",
        .title = "Torque saturation",
        .stage = Stage::kActuator,
        .scope = Scope::kJoint,
        .equation = "tau = clip(u, -tau_max, tau_max)",
        .sentence = "{joint} never delivers more than {limit}, whatever it is asked for.",
        .parameters = {{"limit", "tau_max", "N*m", "N", 0, kInf, 0, 0.2, true, true, "largest torque"}},
        .family = "actuator",
        .confused_with = {"torque_gain"},
        .reference = "",
        .shows_over = Variable::kEffort,
        .options = {},
        .needs = {Need::kPeakEffort},
    };
  }

  static Inference Inferred() {
    return {.terms = {{Regressor::kBeyond, {}, true}},
            .shape = "limit",
            .coefficient = Inference::Near::kOneOrBelowLast,
            .prior = [](const std::string&, double nominal, const EffectSpec&,
                        const JointSize& joint) -> std::optional<Prior> {
              return Prior{nominal, joint.torque, 1e-3 * joint.torque, 50 * joint.torque};
            }};
  }

  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    const S limited = Select(law.drive > p[0], p[0], law.drive);
    law.drive = Select(limited < -p[0], -p[0], limited);
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
