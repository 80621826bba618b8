// The measured state is old when it is stamped.
//
//   q_measured(t) = q(t − T),  v_measured(t) = v(t − T)        T [s] ≥ 0
//
// With option "signal" = "position" or "velocity" only that one is late.
#pragma once

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct SensorDelay {
  static constexpr Role kRole = Role::kSensorDelay;
  static constexpr Phase kPhase = Phase::kNotLocal;

  static EffectInfo Info() {
    return {
        .id = "sensor_delay",
        .title = "Sensor delay",
        .stage = Stage::kSensor,
        .scope = Scope::kJoint,
        .equation = "q_measured(t) = q(t - T)",
        .sentence = "{joint}'s encoder reports where the joint was {delay} earlier.",
        .parameters = {{"delay", "T", "s", "s", 0, 1, 0, 0.01, false, false, "delay"}},
        .family = "timing",
        .confused_with = {"actuator_delay", "actuator_lag"},
        .reference = "",
        .options = {{"signal", {"both", "position", "velocity"}}},
        .needs = {Need::kDenseRows},
    };
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
