// The drive delivers a multiple of the torque it is asked for.
//
//   tau = g·u        g [–], nominal 1
#pragma once

#include <algorithm>

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct TorqueGain {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kGain;
  static constexpr double kMost = 300.0;  // of a reducer that was left out, and of a unit

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

  static Inference Inferred() {
    return {
        .terms = {{Regressor::kEffort, {"gain"}}},
        .common = true,
        .probe = Probe::kReversals,
        .starts = [](const Found& f) -> std::vector<Start> {
          return {{{{"gain", std::clamp(1.0 + f.c[0], 0.2, kMost)}}}};
        },
        .prior = [](const std::string&, double, const EffectSpec&, const JointSize&) -> std::optional<Prior> {
          return Prior{1, 0.3, 1 / kMost, kMost};
        },
        .for_many_bodies = true};
  }

  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    law.drive *= p[0];
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
