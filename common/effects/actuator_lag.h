// A drive that follows its command like a first-order filter.
//
//   T·τ̇ + τ = u        T [s] > 0;  state: τ [N·m]
//
// Exact for a command that is constant over the step (its average is used), for any T/h:
//   τ(h) = u + (τ₀ − u)·e^{−h/T},   mean over the step = u + (τ₀ − u)·(1 − e^{−h/T})·T/h.
#pragma once

#include <algorithm>

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct ActuatorLag {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kLag;
  static constexpr int kStates = 1;
  static constexpr const char* kStateNames[] = {"lagged_torque"};

  static EffectInfo Info() {
    return {
        .id = "actuator_lag",
        .title = "Actuator lag",
        .stage = Stage::kActuator,
        .scope = Scope::kJoint,
        .equation = "T*dtau + tau = u",
        .sentence =
            "{joint}'s torque follows its command like a filter with a time constant of {time_constant}.",
        .parameters = {{"time_constant", "T", "s", "s", 0, kInf, 0, 0.01, false, false, "time constant"}},
        .family = "timing",
        .confused_with = {"actuator_delay", "sensor_delay"},
        .reference = "",
        .options = {},
        .needs = {Need::kDenseRows, Need::kEffort},
    };
  }

  static Inference Inferred() {
    return {
        .terms = {{Regressor::kLagging, {"time_constant"}, true}},
        .coefficient = Inference::Near::kOne,
        .common = true,
        .probe = Probe::kChirp,
        .starts = [](const Found& f) -> std::vector<Start> {
          return {{{{"time_constant", std::clamp(f.c[0] * f.shape, 2e-3, 0.3)}}}};
        },
        .of_strength = [](double, double seconds, const JointSize&) -> Values {
          return {{"time_constant", seconds}};
        },
        .prior = [](const std::string&, double, const EffectSpec&, const JointSize&) -> std::optional<Prior> {
          return Prior{0, 0.03, 5e-5, 0.4};
        }};
  }

  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    using T = Base<S>;
    const S constant = p[0] + T(1e-9);  // zero passes the command through
    const S decay = Exp((-law.step.h) / constant);
    const S start = law.z0[0] - law.drive;
    law.z1[0] = law.drive + start * decay;
    // In an instant (explicit integrators) the torque is the state.
    const S mean = (T(1) - decay) * constant / Select(law.step.h > T(0), law.step.h, T(1));
    law.drive = law.drive + start * Select(law.step.h > T(0), mean, S(T(1)));
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
