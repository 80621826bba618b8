// The command acts later than it is given.
//
//   tau(t) = u(t − T)        T [s] ≥ 0
//
// The step takes the exact average of the delayed command (sim/command_signal.h), so T has a derivative
// even for a zero-order hold.
#pragma once

#include <algorithm>

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct ActuatorDelay {
  static constexpr Role kRole = Role::kCommandDelay;
  static constexpr Phase kPhase = Phase::kNotLocal;

  static EffectInfo Info() {
    return {
        .id = "actuator_delay",
        .title = "Actuator delay",
        .stage = Stage::kActuator,
        .scope = Scope::kJoint,
        .equation = "tau(t) = u(t - T)",
        .sentence = "{joint}'s torque acts {delay} after it is commanded.",
        .parameters = {{"delay", "T", "s", "s", 0, 1, 0, 0.01, false, false, "delay"}},
        .family = "timing",
        .confused_with = {"actuator_lag", "sensor_delay"},
        .reference = "",
        .options = {},
        .needs = {Need::kDenseRows, Need::kEffort},
    };
  }

  static Inference Inferred() {
    return {
        .terms = {{Regressor::kDelayed, {"delay"}, true}},
        .coefficient = Inference::Near::kOne,
        .common = true,
        .slot = Slot::kDelay,
        .probe = Probe::kChirp,
        .starts = [](const Found& f) -> std::vector<Start> {
          return {{{{"delay", std::clamp(f.c[0] * f.shape, 1e-3, 0.3)}}}};
        },
        .of_strength = [](double, double seconds, const JointSize&) -> Values {
          return {{"delay", seconds}};
        },
        .prior = [](const std::string&, double, const EffectSpec&, const JointSize&) -> std::optional<Prior> {
          return Prior{0, 0.03, 0, 0.4};
        }};
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
