// The base does not stand level.
//
//   g = G·(sin a·cos z, sin a·sin z, −cos a) in the base frame,  G = 9.81 m/s² nominal
//   tilt a [rad], azimuth z [rad]
//
// As a rotation of whatever gravity the plant has: by −a about the horizontal axis at azimuth z + π/2.
// At a = 0 the azimuth has no effect and no derivative.
#pragma once

#include <algorithm>
#include <cmath>

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct GravityMisalignment {
  static constexpr Role kRole = Role::kGravity;
  static constexpr Phase kPhase = Phase::kNotLocal;

  static EffectInfo Info() {
    return {
        .id = "gravity_misalignment",
        .title = "Tilted base",
        .stage = Stage::kBody,
        .scope = Scope::kRobot,
        .equation = "g = 9.81*(sin(a)*cos(z), sin(a)*sin(z), -cos(a))",
        .sentence =
            "The base is tilted by {tilt} towards azimuth {azimuth}: gravity does not point where the model "
            "has it.",
        .parameters = {{"tilt", "a", "rad", "rad", -3.1416, 3.1416, 0, 0.05, false, false,
                        "tilt of the base"},
                       {"azimuth", "z", "rad", "rad", -kInf, kInf, 0, 3, false, false,
                        "direction of the tilt"}},
        .family = "load",
        .confused_with = {"parameters_only", "payload", "encoder_offset", "torque_gain"},
        .reference = "",
        .shows_over = Variable::kPosition,
        .options = {},
        .needs = {Need::kTilt},
    };
  }

  static Inference Inferred() {
    return {.starts = Towards,
            .prior = [](const std::string& field, double nominal, const EffectSpec&,
                        const JointSize&) -> std::optional<Prior> {
              return field == "tilt" ? Prior{0, 0.1, -1.5, 1.5} : Prior{nominal, 2};
            },
            .for_many_bodies = true};
  }
  // A gravity change (g_x, g_y) is a tilt of |g_xy|/|g| towards its direction.
  static std::vector<Start> Towards(const Found& f) {
    const double tilt = std::clamp(std::hypot(f.c[0], f.c[1]) / std::max(1e-6, f.gravity), 1e-3, 1.2);
    const double azimuth = std::atan2(f.c[1], f.c[0]);
    std::vector<Start> out = {{{{"tilt", tilt}, {"azimuth", azimuth}}}};
    // To first order a planar arm does not feel the tilt about the line in its plane: only the cosine, and
    // the gradient there is zero.
    if (f.joints <= 2 && tilt < 0.3) {
      const double more = std::max(0.05, 1.5 * tilt), turn = std::acos(tilt / more);
      out.push_back({{{"tilt", more}, {"azimuth", azimuth + turn}}});
    }
    return out;
  }

  template <class S>
  static void Turn(const S* p, S* g) {
    const S ca = Cos(p[0]), sa = Sin(p[0]), cz = Cos(p[1]), sz = Sin(p[1]);
    const S along = g[0] * cz + g[1] * sz, across = g[1] * cz - g[0] * sz;
    const S turned = along * ca - sa * g[2];  // rotation about the axis (−sin z, cos z, 0)
    const S down = along * sa + ca * g[2];
    g[0] = turned * cz - across * sz;
    g[1] = turned * sz + across * cz;
    g[2] = down;
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
