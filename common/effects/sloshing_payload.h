// A mass that moves on the last link: liquid, a loose part, something that hangs.
//
//   on the end-effector link, or on the child link of the last joint (option "point"); m [kg] ≥ 0. Option
//   "form":
//
//   "spring"  a point mass at the link's origin, free in x, y, z against  f = −k·s − b·ṡ,
//             s its displacement in the link's axes;  k [N/m] > 0, b [N·s/m] ≥ 0;  states: s and ṡ
//   "rod"     a mass whose centre is L [m] from a hinge at the link's origin, with a radius of gyration r [m]
//   about
//             that centre, the same in all directions; the hinge turns about two axes, first one of the
//             link's (option "hinge"), then the next of its axes, against  τ = −b·L²·φ̇  on either; states:
//             the angles φ and their rates
//
// The rod stands along the link's third axis from the first, backwards, at φ = 0. Both angles are one where
// it lies along the first axis of the hinge: choose one that gravity is not along. It swings freely through
// all the others.
//
// On a link that hardly turns a rod of length L swings like springs of k = m·9.81/L; on one that does it
// does not, for gravity alone says where it hangs. Adds three bodies to the tree, or two.
#pragma once

#include <cmath>

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct SloshingPayload {
  static constexpr Role kRole = Role::kExtraBodies;
  static constexpr Phase kPhase = Phase::kJoint;
  static constexpr int kRod = 1;                                     // of option "form"
  enum Parameter { kMass, kStiffness, kDamping, kLength, kRadius };  // their order

  static EffectInfo Info() {
    using Only = ParameterInfo::Only;
    return {
        .id = "sloshing_payload",
        .title = "Sloshing payload",
        .stage = Stage::kBody,
        .scope = Scope::kRobot,
        .equation = "m*dds = -k*s - b*ds + m*g",
        .sentence = "The last link carries {mass} that moves in a hold of {stiffness}.",
        .parameters = {{"mass", "m", "kg", "kg", 1e-6, kInf, 0.1, 0.5, false, false, "moving mass"},
                       {"stiffness", "k", "N/m", "N/m", 1e-3, kInf, 100, 100, false, false,
                        "stiffness of the hold", Only::kBoth, "spring"},
                       {"damping", "b", "N*s/m", "N*s/m", 0, kInf, 0.5, 1, false, false,
                        "damping of the hold"},
                       {"length", "L", "m", "m", 1e-4, kInf, 0.1, 0.1, false, false, "length of the rod",
                        Only::kBoth, "rod"},
                       {"radius", "r", "m", "m", 0, kInf, 0, 0.05, false, false,
                        "radius of gyration of the mass", Only::kBoth, "rod"}},
        .family = "load",
        .confused_with = {"payload", "base_flexibility"},
        .reference = "",
        .options = {{"form", {"spring", "rod"}},
                    {"hinge", {"x", "y", "z"}},
                    {"point", {"end_effector", "last_link"}}},
        .forms = {{"form", "rod", "m*(L^2+r^2)*ddphi = -b*L^2*dphi + m*L x (g-a)",
                   "The last link carries {mass} that swings on a rod of {length}."}},
        .needs = {Need::kDenseRows, Need::kAcceleration},
    };
  }

  static Inference Inferred() {
    return {.blind = Hung,
            .prior = [](const std::string& field, double, const EffectSpec& spec,
                        const JointSize& joint) -> std::optional<Prior> {
              if (field == "mass")
                return Prior{0, joint.last_mass, 1e-4 * joint.last_mass, 20 * joint.last_mass};
              if (field == "radius") return Prior{0, 0.05};
              const auto form = spec.options.find("form");
              if (field != "damping" || form == spec.options.end() || form->second != "rod") return {};
              // What swings on a rod may swing for long: of the damping that is critical where it hangs.
              const double critical = 2 * ValueOf(spec, "mass") * std::sqrt(9.81 / ValueOf(spec, "length"));
              return Prior{0, 0.1 * critical};
            },
            .swings = true};
  }
  // A pendulum's k/m is g/L, whatever its mass; fits find the mass from a small one, not from a large one.
  static std::vector<Start> Hung(const Blind& b) {
    struct Guess {
      double share, length;
      bool last_link;
    };
    std::vector<Start> out;
    for (const Guess g : {Guess{0.02, 0.05, true}, Guess{0.05, 0.1, true}, Guess{0.03, 0.07, false}}) {
      if (b.end_effector_is_last && g.last_link && g.share > 0.03) continue;
      const double mass = g.share * b.joint.last_mass, k = mass * 9.81 / g.length;
      out.push_back({{{"mass", mass}, {"stiffness", k}, {"damping", 0.05 * std::sqrt(k * mass)}}});
      if (!b.end_effector_is_last && g.last_link) out.back().options["point"] = "last_link";
    }
    return out;
  }

  // On the program of each of the three joints, or of the hinge's two.
  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    if (law.option == kRod) {
      law.viscous += p[kDamping] * p[kLength] * p[kLength];
    } else {
      SpringAndDamper(p[kStiffness], p[kDamping], law);
    }
  }

  // Of the mass on a rod, in the link's axes at φ = 0, about the hinge. hinge: its first axis (0 x, 1 y, 2
  // z); p: mass, length, radius; phi as Payload's.
  template <class S>
  static void AddRodInertia(const S* p, int hinge, S* phi) {
    constexpr int kDiagonal[] = {4, 7, 9};
    const int along = (hinge + 2) % 3;
    const S own = p[0] * p[2] * p[2], far = p[0] * p[1] * p[1];
    phi[0] += p[0];
    phi[1 + along] -= p[0] * p[1];
    for (int axis = 0; axis < 3; ++axis) phi[kDiagonal[axis]] += axis == along ? own : own + far;
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
