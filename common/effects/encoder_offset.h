// An encoder whose zero is off.
//
//   q_measured = q + o        o [rad]
//
// Recordings start from measured positions: whoever sets an initial state from a measurement subtracts
// the offset.
#pragma once

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct EncoderOffset {
  static constexpr Role kRole = Role::kSensorOffset;
  static constexpr Phase kPhase = Phase::kNotLocal;

  static EffectInfo Info() {
    return {
        .id = "encoder_offset",
        .title = "Encoder offset",
        .stage = Stage::kSensor,
        .scope = Scope::kJoint,
        .equation = "q_measured = q + o",
        .sentence = "{joint}'s encoder reads {offset} too much.",
        .parameters = {{"offset", "o", "rad", "m", -kInf, kInf, 0, 0.05, false, false,
                        "measured minus true position"}},
        .family = "load",
        .confused_with = {"gravity_misalignment", "payload", "parameters_only"},
        .reference = "",
        .shows_over = Variable::kPosition,
        .options = {},
        .needs = {Need::kPosture},
    };
  }

  static Inference Inferred() {
    return {
        .prior = [](const std::string&, double, const EffectSpec&, const JointSize&) -> std::optional<Prior> {
          return Prior{0, 0.1};
        },
        .for_many_bodies = true};
  }

  template <class S>
  static void Measure(const S* p, S* q) {
    *q += p[0];
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
