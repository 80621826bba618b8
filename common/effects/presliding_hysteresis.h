// Friction as a bristle that bends before it slides (Dahl's model with a damping term; LuGre without the
// Stribeck drop, which stribeck_friction adds).
//
//   ż = v − σ₀·|v|/c·z ,   tau_f = −(σ₀·z + σ₁·ż)
//   z [rad] state    σ₀ [N·m/rad] > 0    c [N·m] > 0 level while sliding    σ₁ [N·m·s/rad] ≥ 0
//
// At rest the joint sits in a stiff spring σ₀ and returns elastically; after many c/σ₀ of travel it
// slides with force c. The bristle equation is linear in z over a step and is taken implicitly, so σ₀ may
// be stiff.
// Ref: Canudas de Wit, Olsson, Åström, Lischinsky, IEEE TAC 40(3), 1995.
#pragma once

#include <algorithm>
#include <cmath>

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct PreslidingHysteresis {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kJoint;
  static constexpr int kStates = 1;
  static constexpr const char* kStateNames[] = {"bristle"};

  static EffectInfo Info() {
    return {
        .id = "presliding_hysteresis",
        .title = "Presliding hysteresis",
        .stage = Stage::kJoint,
        .scope = Scope::kJoint,
        .equation = "dz = dq - s0*abs(dq)/c*z, tau_f = -(s0*z + s1*dz)",
        .sentence =
            "{joint} springs back before it slides: friction of {coulomb} through a bristle of "
            "{bristle_stiffness}.",
        .parameters = {{"bristle_stiffness", "s0", "N*m/rad", "N/m", 1e-3, kInf, 1000, 1000, false, false,
                        "stiffness before sliding"},
                       {"coulomb", "c", "N*m", "N", 0, kInf, 0, 0.1, true, false, "level while sliding"},
                       {"bristle_damping", "s1", "N*m*s/rad", "N*s/m", 0, kInf, 0, 1, false, false,
                        "damping of the bristle"}},
        .family = "friction",
        .confused_with = {"viscous_friction", "coulomb_friction", "stribeck_friction", "asymmetric_friction",
                          "load_dependent_friction", "thermal_drift", "joint_elasticity", "backlash"},
        .reference = "Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE TAC 40(3), 1995",
        .options = {},
        .needs = {Need::kBothWays, Need::kDenseRows},
    };
  }

  static Inference Inferred() {
    return {.terms = {{Regressor::kBristle, {"coulomb"}, true}},
            .slot = Slot::kDryFriction,
            .probe = Probe::kSlowRamps,
            .starts = [](const Found& f) -> std::vector<Start> {
              const double level = std::max(f.c[0], f.least_share * f.joint.torque);
              return {{{{"coulomb", level},
                        {"bristle_stiffness", level / f.shape},
                        {"bristle_damping", 0.2 * std::sqrt(level / f.shape * f.joint.inertia)}}}};
            },
            .of_strength = [](double level, double, const JointSize& joint) -> Values {
              const double stiffness = level / 0.02;
              return {{"coulomb", level},
                      {"bristle_stiffness", stiffness},
                      {"bristle_damping", 0.3 * std::sqrt(stiffness * joint.inertia)}};
            },
            .prior = [](const std::string& field, double nominal, const EffectSpec&,
                        const JointSize&) -> std::optional<Prior> {
              if (field == "bristle_stiffness") return Prior{nominal, nominal, 0.1 * nominal, 50 * nominal};
              if (field == "bristle_damping") return Prior{0, std::max(1e-6, 2 * nominal)};
              return {};
            }};
  }

  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    using T = Base<S>;
    const T h = law.step.h;
    const S& stiffness = p[0];
    const S& z = law.z0[0];
    const S v = law.VelocityAt(law.OscillationWeight(stiffness * (h * h / law.reference_mass)));
    // A level of zero is no friction: the bristle then slips freely.
    const S level = p[1] + T(1e-12);
    const S x = stiffness * Abs(v) * h / level;
    const S weight = law.Weight(x);
    const S change = (v * h - x * z) / (T(1) + weight * x);
    law.z1[0] = z + change;
    law.force -=
        stiffness * (z + weight * change) + p[2] * Select(h > T(0), S(change / Select(h > T(0), h, T(1))), v);
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
