// The measured state is old when it is stamped.
//
//   q_measured(t) = q(t − T),  v_measured(t) = v(t − T)        T [s] ≥ 0
//
// With option "signal" = "position" or "velocity" only that one is late.
#pragma once

#include <algorithm>

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
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

  static Inference Inferred() {
    return {
        .common = true,
        .slot = Slot::kDelay,
        .probe = Probe::kChirp,
        .starts = [](const Found& f) -> std::vector<Start> {
          return {{{{"delay", std::clamp(f.c[0], 1e-3, 0.3)}}}};
        },
        .of_strength = [](double, double seconds, const JointSize&) -> Values {
          return {{"delay", seconds}};
        },
        .prior = [](const std::string&, double, const EffectSpec&, const JointSize&) -> std::optional<Prior> {
          return Prior{0, 0.03, 0, 0.4};
        },
        // A drive's command waits for its bus and cycle more often than a reading does; where both are on
        // all joints nothing but the first moments of a recording tells them apart.
        .rare = 2.0};
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
