// A spring on the joint: cable, hose, counterbalance.
//
//   tau = −k·(q − q₀) − k₃·(q − q₀)³        k [N·m/rad], k₃ [N·m/rad³], q₀ [rad]
//
// Taken at the step's mean position, so a stiff one does not force small steps. Conservative.
#pragma once

#include <algorithm>
#include <cmath>

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct PositionSpring {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kJoint;

  static EffectInfo Info() {
    return {
        .id = "position_spring",
        .title = "Spring on the joint",
        .stage = Stage::kJoint,
        .scope = Scope::kJoint,
        .equation = "tau = -k*(q-q0) - k3*(q-q0)^3",
        .sentence =
            "{joint} is pulled back towards {center} by a spring of {stiffness} that the model does not "
            "have.",
        .parameters = {{"stiffness", "k", "N*m/rad", "N/m", -kInf, kInf, 0, 0.2, true, false, "stiffness"},
                       {"cubic", "k3", "N*m/rad^3", "N/m^3", -kInf, kInf, 0, 0.1, true, false, "hardening"},
                       {"center", "q0", "rad", "m", -kInf, kInf, 0, 1, false, false,
                        "position without force"}},
        .family = "position",
        .confused_with = {"torque_ripple", "unknown_field"},
        .reference = "",
        .shows_over = Variable::kPosition,
        .options = {},
        .needs = {Need::kTravel},
    };
  }

  static Inference Inferred() {
    return {.terms = {{Regressor::kConstant}, {Regressor::kPosition, {"stiffness"}}},
            .slot = Slot::kPositionForce,
            .starts = [](const Found& f) -> std::vector<Start> {
              const double k = f.c[1], center = std::abs(k) > 1e-9 ? f.shape + f.c[0] / k : f.shape;
              return {{{{"stiffness", k}, {"cubic", 0.0}, {"center", std::clamp(center, f.low, f.high)}}}};
            },
            .of_strength = [](double, double, const JointSize& joint) -> Values {
              const double range = std::max(0.05, joint.high - joint.low);
              return {{"stiffness", 0.3 * joint.torque / range},
                      {"cubic", 0.0},
                      {"center", 0.5 * (joint.low + joint.high)}};
            },
            .force_at = [](const Values& v, double position) -> double {
              return Force(v.at("stiffness"), v.at("cubic"), position - v.at("center"));
            },
            .prior = [](const std::string& field, double nominal, const EffectSpec&,
                        const JointSize& joint) -> std::optional<Prior> {
              const double torque = joint.torque, range = joint.Range();
              if (field == "stiffness") return Prior{0, torque / range};
              if (field == "cubic") return Prior{0, torque / range / range / range};
              return Prior{nominal, 1.0, nominal - 3, nominal + 3};
            }};
  }

  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    using T = Base<S>;
    const S x0 = law.q0 - p[2];
    const S stiffness = p[0] + T(3) * p[1] * x0 * x0;
    const S positive = Select(stiffness > T(0), stiffness, S(T(0)));
    const S weight = law.OscillationWeight(positive * (law.step.h * law.step.h / law.reference_mass));
    law.force += Force(p[0], p[1], law.PositionAt(weight) - p[2]);
  }

 private:
  template <class S>
  static S Force(const S& stiffness, const S& cubic, const S& x) {
    return -((stiffness + cubic * x * x) * x);
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
