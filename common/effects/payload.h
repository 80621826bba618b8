// A mass held rigidly by the last link.
//
//   a point mass m [kg] ≥ 0 at com (x, y, z) [m] in the frame of the child link of the last joint
//
// The same as a change of the last link's parameters; its own name because a gripper holds things.
#pragma once

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
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
