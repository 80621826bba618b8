// A mass held rigidly by the last link.
//
//   a point mass m [kg] ≥ 0 at com (x, y, z) [m] in the frame of the child link of the last joint
//
// The same as a change of the last link's parameters; its own name because a gripper holds things.
#pragma once

#include <algorithm>

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct Payload {
  static constexpr Role kRole = Role::kBodyInertia;
  static constexpr Phase kPhase = Phase::kNotLocal;

  static EffectInfo Info() {
    return {
        .id = "payload",
        .title = "Payload",
        .stage = Stage::kBody,
        .scope = Scope::kRobot,
        .equation = "m, com added to the last link",
        .sentence =
            "The last link carries {mass} at ({com_x}, {com_y}, {com_z}) that the model does not have.",
        .parameters = {{"mass", "m", "kg", "kg", 0, kInf, 0, 1, false, false, "mass"},
                       {"com_x", "x", "m", "m", -kInf, kInf, 0, 0.1, false, false, "centre of mass"},
                       {"com_y", "y", "m", "m", -kInf, kInf, 0, 0.1, false, false, "centre of mass"},
                       {"com_z", "z", "m", "m", -kInf, kInf, 0, 0.1, false, false, "centre of mass"}},
        .family = "load",
        .confused_with = {"parameters_only", "torque_gain", "gravity_misalignment", "encoder_offset",
                          "rotor_inertia"},
        .reference = "",
        .shows_over = Variable::kPosition,
        .options = {},
        .needs = {Need::kLastMass},
    };
  }

  static Inference Inferred() {
    return {.probe = Probe::kReversals,
            .starts = Inside,
            .blind = [](const Blind& b) -> std::vector<Start> {
              // From the middle of the last link's own mass.
              return {{{{"mass", 0.1 * b.joint.last_mass},
                        {"com_x", b.last_link[1]},
                        {"com_y", b.last_link[2]},
                        {"com_z", b.last_link[3]}}}};
            },
            .prior = [](const std::string& field, double, const EffectSpec&,
                        const JointSize& joint) -> std::optional<Prior> {
              if (field == "mass") return Prior{0, 0.5 * joint.last_mass};
              return Prior{0, 0.15, -1, 1};
            },
            .for_many_bodies = true};
  }
  // Changes of the last link's mass and centre of mass as a body of their own, in that link's frame.
  static std::vector<Start> Inside(const Found& f) {
    const double mass = std::max(f.c[0], 0.01 * f.joint.last_mass);
    double com[3];
    for (int i = 0; i < 3; ++i) {
      const double moment = f.last_link[0] * f.c[static_cast<size_t>(i) + 1] + f.c[0] * f.last_link[i + 1];
      com[i] = std::clamp(moment / mass, -0.3, 0.3);
    }
    return {{{{"mass", mass}, {"com_x", com[0]}, {"com_y", com[1]}, {"com_z", com[2]}}}};
  }

  // phi: m, m·c (3), I_xx, I_xy, I_xz, I_yy, I_yz, I_zz about the origin of the link's frame.
  template <class S>
  static void AddInertia(const S* p, S* phi) {
    const S &m = p[0], &x = p[1], &y = p[2], &z = p[3];
    phi[0] += m;
    phi[1] += m * x;
    phi[2] += m * y;
    phi[3] += m * z;
    phi[4] += m * (y * y + z * z);
    phi[5] -= m * x * y;
    phi[6] -= m * x * z;
    phi[7] += m * (x * x + z * z);
    phi[8] -= m * y * z;
    phi[9] += m * (x * x + y * y);
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
