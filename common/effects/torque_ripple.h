// Torque that varies with position: cogging, gear mesh, torque-sensor ripple.
//
//   tau = u + a·sin(n·q + φ)        a [N·m], n [cycles per revolution], φ [rad]
//
// For a prismatic joint n counts cycles per 2π m.
#pragma once

#include <algorithm>
#include <cmath>

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct TorqueRipple {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kRipple;
  static constexpr Phase kPhaseByOption[] = {kPhase, Phase::kCommand};

  static constexpr double kLeastPeriods = 0.4;  // over all that was recorded of its joint, that tell it

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
        // Cogging and gear mesh act on the motor; a torque sensor's ripple on what the drive's lag follows.
        .options = {{"acts_on", {"motor", "command"}}},
        .needs = {Need::kPeriods},
    };
  }

  static Inference Inferred() {
    return {.terms = {{Regressor::kSine}, {Regressor::kCosine}},
            .shape = "cycles_per_rev",
            .starts = [](const Found& f) -> std::vector<Start> {
              return {{{{"amplitude", std::hypot(f.c[0], f.c[1])},
                        {"cycles_per_rev", f.shape},
                        {"phase", std::atan2(f.c[1], f.c[0])}}}};
            },
            .prior = [](const std::string& field, double nominal, const EffectSpec&,
                        const JointSize& joint) -> std::optional<Prior> {
              if (field == "phase") return Prior{nominal, 2};
              if (field != "cycles_per_rev") return {};
              return Prior{nominal, 0.1 * nominal + 0.5,
                           std::max(2.0, kLeastPeriods * 2 * M_PI / joint.Range()), 300};
            }};
  }

  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    using T = Base<S>;
    law.drive += p[0] * Sin(p[1] * law.PositionAt(S(T(0.5))) + p[2]);
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
