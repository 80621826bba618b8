// A torque without a name: a smooth function of one variable per joint, flexible enough to stand for what
// no other effect says.
//
//   tau = Σ_i w_i·B((x − x_i)/Δ),   x = q, v, the drive torque or time (option "variable")
//   tau = -v·Σ_i w_i·B((q − x_i)/Δ)  where the variable is "drag": damping of the joint that depends on where
//                                    it is, w_i the torque at 1 rad/s (1 m/s)
//   eight nodes x_i, evenly from `low` to `high` (spacing Δ); B the cubic B-spline, twice differentiable
//
// Zero far outside [low − 2Δ, high + 2Δ]. Linear in w. Neither dissipative nor conservative in general.
#pragma once

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct UnknownField {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kLoad;

  static constexpr double kRare = 6.0;

  static EffectInfo Info() {
    return {
        .id = "unknown_field",
        .title = "Unnamed force",
        .stage = Stage::kJoint,
        .scope = Scope::kJoint,
        .equation = "tau = sum_i w_i*B((q-x_i)/D)",
        .sentence = "{joint} feels a repeatable force that has no name here.",
        .parameters = {{"w0", "w0", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 0"},
                       {"w1", "w1", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 1"},
                       {"w2", "w2", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 2"},
                       {"w3", "w3", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 3"},
                       {"w4", "w4", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 4"},
                       {"w5", "w5", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 5"},
                       {"w6", "w6", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 6"},
                       {"w7", "w7", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 7"},
                       {"low", "low", "rad", "m", -kInf, kInf, -3.1416, 3, false, false, "first node"},
                       {"high", "high", "rad", "m", -kInf, kInf, 3.1416, 3, false, false, "last node"}},
        .family = "position",
        .confused_with = {"torque_ripple", "position_spring"},
        .reference = "",
        .shows_over = Variable::kPosition,
        .options = {{"variable", {"position", "velocity", "torque", "time", "drag"}}},
        .forms = {{"variable", "velocity", "tau = sum_i w_i*B((dq-x_i)/D)",
                   "{joint} feels a force that follows its speed and has no name here.", Variable::kVelocity},
                  {"variable", "torque", "tau = sum_i w_i*B((u-x_i)/D)",
                   "{joint} feels a force that follows its effort and has no name here.", Variable::kEffort},
                  {"variable", "time", "tau = sum_i w_i*B((t-x_i)/D)",
                   "{joint} feels a force that follows time and has no name here.", Variable::kTime},
                  {"variable", "drag", "tau = -dq*sum_i w_i*B((q-x_i)/D)",
                   "{joint} feels a drag that depends on where it is and has no name here.",
                   Variable::kPosition}},
        .needs = {Need::kTravel},
    };
  }

  static Inference Inferred() {
    return {.terms = {{Regressor::kPositionPiece}, {Regressor::kVelocityPiece}},
            .pieces = true,
            .unnamed = true,
            .slot = Slot::kPositionForce,
            .starts = [](const Found& f) -> std::vector<Start> {
              Start start{{{"low", f.joint.low}, {"high", f.joint.high}}, {{"variable", "position"}}};
              for (size_t i = 0; i < f.c.size() && i < kNodes; ++i)
                start.values["w" + std::to_string(i)] = f.c[i];
              return {start};
            },
            .prior = [](const std::string&, double, const EffectSpec& spec,
                        const JointSize& joint) -> std::optional<Prior> {
              if (spec.options.count("variable") == 0 || spec.options.at("variable") != "drag") return {};
              return Prior{0, 0.5 * joint.torque / joint.speed, 0};
            },
            .rare = kRare};
  }

  static constexpr int kNodes = 8;
  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    using T = Base<S>;
    const S half(T(0.5));
    const bool drag = law.option == 4;
    const S x = law.option == 0 || drag ? law.PositionAt(half)
                : law.option == 1       ? law.VelocityAt(half)
                : law.option == 2       ? law.link
                                        : S(law.step.t + T(0.5) * law.step.h);
    const S spacing = (p[kNodes + 1] - p[kNodes]) / T(kNodes - 1);
    const S at = (x - p[kNodes]) / spacing;
    S sum(T(0));
    for (int i = 0; i < kNodes; ++i) sum += p[i] * Spline(S(at - T(i)));
    if (drag) {
      law.viscous += sum;
    } else {
      law.force += sum;
    }
  }
  // 2/3 at 0, zero beyond ±2.
  template <class S>
  static S Spline(const S& x) {
    using T = Base<S>;
    const S a = Abs(x);
    const S outer = T(2) - a, inner = T(1) - a;
    const S o = Select(outer > T(0), outer, S(T(0))), i = Select(inner > T(0), inner, S(T(0)));
    return (o * o * o - T(4) * i * i * i) * T(1.0 / 6.0);
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
