// A mass that moves in a soft hold on the last link: liquid, a loose part, something that hangs.
//
//   a point mass m at the origin of the end-effector link, or of the child link of the last joint (option
//   "point"), free in x, y, z against
//   f = −k·s − b·ṡ,  s its displacement in the link's axes
//   m [kg] ≥ 0, k [N/m] > 0, b [N·s/m] ≥ 0;  states: s and ṡ
//
// A pendulum of length L swings like k = m·9.81/L. Adds three bodies to the tree.
#pragma once

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct SloshingPayload {
  static constexpr Role kRole = Role::kExtraBodies;
  static constexpr Phase kPhase = Phase::kJoint;

  static EffectInfo Info() {
    return {
        .id = "sloshing_payload",
        .title = "Sloshing payload",
        .stage = Stage::kBody,
        .scope = Scope::kRobot,
        .equation = "m*dds = -k*s - b*ds + m*g",
        .sentence = "The last link carries {mass} that moves in a hold of {stiffness}.",
        .parameters = {{"mass", "m", "kg", "kg", 1e-6, kInf, 0.1, 0.5, false, false, "moving mass"},
                       {"stiffness", "k", "N/m", "N/m", 1e-3, kInf, 100, 100, false, false,
                        "stiffness of the hold"},
                       {"damping", "b", "N*s/m", "N*s/m", 0, kInf, 0.5, 1, false, false,
                        "damping of the hold"}},
        .family = "load",
        .confused_with = {"payload", "base_flexibility"},
        .reference = "",
        .options = {{"point", {"end_effector", "last_link"}}},
    };
  }

  // On the program of each of the three joints.
  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    SpringAndDamper(p[1], p[2], law);
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
