// Coulomb friction that grows with the torque the joint transmits (gear mesh, bearings under load).
//
//   tau_f = −(c + μ·|tau|)·sign(v)        c [N·m] ≥ 0, μ ≥ 0
//
// tau is the torque behind the transmission (the drive's torque where that is rigid), averaged over
// the step. Dissipative. No state.
#pragma once

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct LoadDependentFriction {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kLoad;
  static constexpr bool kFriction = true;  // writes friction levels

  static EffectInfo Info() {
    return {
        .id = "load_dependent_friction",
        .title = "Load-dependent friction",
        .stage = Stage::kJoint,
        .scope = Scope::kJoint,
        .equation = "tau_f = -(c + mu*abs(tau))*sign(dq)",
        .sentence =
            "{joint} loses more against its motion the more torque it carries: friction of {coulomb} plus "
            "{load_coefficient} times the torque.",
        .parameters = {{"coulomb", "c", "N*m", "N", 0, kInf, 0, 0.1, true, false, "level without load"},
                       {"load_coefficient", "mu", "-", "-", 0, 1, 0, 0.1, false, false,
                        "growth of the level with the torque"}},
        .family = "friction",
        .confused_with = {"viscous_friction", "coulomb_friction", "stribeck_friction", "asymmetric_friction",
                          "presliding_hysteresis", "thermal_drift", "torque_gain"},
        .reference = "Bittencourt, Gunnarsson, J. Dyn. Sys. 134(5), 2012",
        .options = {},
        .of_drive = true,
        .needs = {Need::kBothWays, Need::kLoad},
    };
  }

  static Inference Inferred() {
    return {.terms = {{Regressor::kDirection, {"coulomb"}, true},
                      {Regressor::kUnderLoad, {"load_coefficient"}, true}},
            .slot = Slot::kDryFriction,
            .probe = Probe::kLoads,
            .of_strength = [](double level, double, const JointSize& joint) -> Values {
              return {{"coulomb", 0.5 * level}, {"load_coefficient", 0.5 * level / joint.torque}};
            },
            .prior = [](const std::string& field, double, const EffectSpec&,
                        const JointSize&) -> std::optional<Prior> {
              if (field != "load_coefficient") return {};
              return Prior{0, 0.3, 0, 2};
            },
            // All of the torque and no level of its own is no friction.
            .plausible = [](const std::vector<double>& c) { return c[0] > 0 && c[1] <= 0.8; }};
  }

  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    const S level = p[0] + p[1] * Abs(law.link);
    law.level_positive += level;
    law.level_negative += level;
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
