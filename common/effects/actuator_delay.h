// The command acts later than it is given.
//
//   tau(t) = u(t − T)        T [s] ≥ 0
//
// The step takes the exact average of the delayed command (sim/command_signal.h), so T has a derivative
// even for a zero-order hold.
#pragma once

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
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
};

}  // namespace RG_ISA
}  // namespace rg::effects
