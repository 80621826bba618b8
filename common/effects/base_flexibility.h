// The base stands on an elastic mount.
//
//   two small rotations φ of the base about its x and y axes:  tau_φ = −k·φ − b·φ̇
//   k [N·m/rad] > 0, b [N·m·s/rad] ≥ 0;  states: φ_x, φ_y and their rates
//
// Adds two bodies to the tree in front of the base link (sim/plant.h); the base link's own inertia moves
// with them.
#pragma once

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct BaseFlexibility {
  static constexpr Role kRole = Role::kExtraBodies;
  static constexpr Phase kPhase = Phase::kJoint;

  static EffectInfo Info() {
    return {
        .id = "base_flexibility",
        .title = "Flexible base",
        .stage = Stage::kBody,
        .scope = Scope::kRobot,
        .equation = "tau_base = -k*phi - b*dphi",
        .sentence = "The base rocks on a mount of {stiffness} that the model does not have.",
        .parameters = {{"stiffness", "k", "N*m/rad", "N*m/rad", 1e-3, kInf, 1e4, 1e4, false, false,
                        "stiffness of the mount"},
                       {"damping", "b", "N*m*s/rad", "N*m*s/rad", 0, kInf, 20, 20, false, false,
                        "damping of the mount"}},
        .family = "compliance",
        .confused_with = {"joint_elasticity", "backlash"},
        .reference = "",
        .options = {},
        .needs = {Need::kResonances, Need::kAcceleration},
    };
  }

  static Inference Inferred() {
    return {.probe = Probe::kVibration,
            .blind =
                [](const Blind& b) {
                  std::vector<Start> out;
                  const double k = 15 * b.joint.torque;
                  for (const double factor : {1.0, 2.5, 6.0, 15.0})
                    out.push_back({{{"stiffness", k * factor}, {"damping", 0.02 * k * factor}}});
                  return out;
                },
            .chained = true};
  }

  // On the program of each of the two joints.
  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    SpringAndDamper(p[0], p[1], law);
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
