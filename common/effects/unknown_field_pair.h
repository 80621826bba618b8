// A torque without a name on one joint that depends on the positions of two: a smooth surface.
//
//   tau = Σ_ij w_ij·B((q − x_i)/Δx)·B((s − y_j)/Δy),   q: the joint's own position, s: the other joint's
//   six by six nodes, evenly from `low` to `high` and from `other_low` to `other_high`; B as in
//   unknown_field.h
//
// The other joint is seen in the middle of the step as its velocity at the step's begin has it. Zero far
// outside the nodes. Linear in w. Joints: the one that is seen, the one that feels the force.
#pragma once

#include <algorithm>
#include <cmath>

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"
#include "common/effects/unknown_field.h"

namespace rg::effects {
inline namespace RG_ISA {

struct UnknownFieldPair {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kLoad;

  static EffectInfo Info() {
    return {
        .id = "unknown_field_pair",
        .title = "Unnamed force over two joints",
        .stage = Stage::kJoint,
        .scope = Scope::kJointPair,
        .equation = "tau = sum_ij w_ij*B((q-x_i)/Dx)*B((s-y_j)/Dy)",
        .sentence = "A repeatable force that has no name here depends on the positions of {joint}.",
        .parameters = {{"w00", "w00", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 0, 0"},
                       {"w01", "w01", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 0, 1"},
                       {"w02", "w02", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 0, 2"},
                       {"w03", "w03", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 0, 3"},
                       {"w04", "w04", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 0, 4"},
                       {"w05", "w05", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 0, 5"},
                       {"w10", "w10", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 1, 0"},
                       {"w11", "w11", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 1, 1"},
                       {"w12", "w12", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 1, 2"},
                       {"w13", "w13", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 1, 3"},
                       {"w14", "w14", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 1, 4"},
                       {"w15", "w15", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 1, 5"},
                       {"w20", "w20", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 2, 0"},
                       {"w21", "w21", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 2, 1"},
                       {"w22", "w22", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 2, 2"},
                       {"w23", "w23", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 2, 3"},
                       {"w24", "w24", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 2, 4"},
                       {"w25", "w25", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 2, 5"},
                       {"w30", "w30", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 3, 0"},
                       {"w31", "w31", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 3, 1"},
                       {"w32", "w32", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 3, 2"},
                       {"w33", "w33", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 3, 3"},
                       {"w34", "w34", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 3, 4"},
                       {"w35", "w35", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 3, 5"},
                       {"w40", "w40", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 4, 0"},
                       {"w41", "w41", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 4, 1"},
                       {"w42", "w42", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 4, 2"},
                       {"w43", "w43", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 4, 3"},
                       {"w44", "w44", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 4, 4"},
                       {"w45", "w45", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 4, 5"},
                       {"w50", "w50", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 5, 0"},
                       {"w51", "w51", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 5, 1"},
                       {"w52", "w52", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 5, 2"},
                       {"w53", "w53", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 5, 3"},
                       {"w54", "w54", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 5, 4"},
                       {"w55", "w55", "N*m", "N", -kInf, kInf, 0, 0.05, true, false, "value at node 5, 5"},
                       {"low", "low", "rad", "m", -kInf, kInf, -3.1416, 3, false, false, "first node"},
                       {"high", "high", "rad", "m", -kInf, kInf, 3.1416, 3, false, false, "last node"},
                       {"other_low", "other_low", "rad", "m", -kInf, kInf, -3.1416, 3, false, false,
                        "first node of the other joint"},
                       {"other_high", "other_high", "rad", "m", -kInf, kInf, 3.1416, 3, false, false,
                        "last node of the other joint"}},
        .family = "position",
        .confused_with = {"unknown_field"},
        .reference = "",
        .shows_over = Variable::kPosition,
        .options = {},
        .needs = {Need::kTravel},
    };
  }

  static Inference Inferred() {
    return {.unnamed = true,
            .prior = [](const std::string&, double, const EffectSpec& spec,
                        const JointSize&) -> std::optional<Prior> {
              double squares = 0, count = 0;  // of the weights that it starts with
              for (const auto& [owner, values] : spec.values) {
                for (const auto& [name, value] : values) {
                  if (name[0] == 'w') squares += value * value, ++count;
                }
              }
              return Prior{0, 2 * std::max(1e-9, std::sqrt(squares / std::max(1.0, count)))};
            },
            .rare = UnknownField::kRare};
  }

  static constexpr int kNodes = 6;
  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    using T = Base<S>;
    const S* low = p + kNodes * kNodes;
    const S x = (law.PositionAt(S(T(0.5))) - low[0]) * T(kNodes - 1) / (low[1] - low[0]);
    const S y = (law.coupled - low[2]) * T(kNodes - 1) / (low[3] - low[2]);
    S across[kNodes];
    for (int j = 0; j < kNodes; ++j) across[j] = UnknownField::Spline(S(y - T(j)));
    for (int i = 0; i < kNodes; ++i) {
      S sum(T(0));
      for (int j = 0; j < kNodes; ++j) sum += p[i * kNodes + j] * across[j];
      law.force += UnknownField::Spline(S(x - T(i))) * sum;
    }
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
