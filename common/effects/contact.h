// A soft surface or stop that is met in part of the workspace.
//
//   x = position along the normal of what touches;  depth d = height − x
//   f = max(0, k·d − b·ẋ) along the normal where d > 0        k [N/m], b [N·s/m] ≥ 0, height [m]
//
// Without joints: the origin of the end-effector link, or of the child link of the last joint (option
// "point"), meets a plane of the base frame with that normal (frictionless). With joints: a stop for the
// joint's own coordinate ("z": it pushes up from below `height`; "-z": down from above −height); read
// N·m/rad, N·m·s/rad, rad. Damping grows over the first 0.1 mm (0.1 mrad), so that the force has no jump.
// Dissipative.
#pragma once

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct Contact {
  static constexpr Role kRole = Role::kJointOrPointForce;
  static constexpr Phase kPhase = Phase::kJoint;

  static EffectInfo Info() {
    return {
        .id = "contact",
        .title = "Contact",
        .stage = Stage::kEnvironment,
        .scope = Scope::kJointOrRobot,
        .equation = "f = max(0, k*d - b*dx), d = height - x",
        .sentence =
            "{joint} meets something soft in part of its workspace: a surface at {height} with {stiffness}.",
        .parameters = {{"stiffness", "k", "N/m", "N/m", 0, kInf, 1000, 1000, false, false, "stiffness"},
                       {"damping", "b", "N*s/m", "N*s/m", 0, kInf, 10, 10, false, false, "damping"},
                       {"height", "height", "m", "m", -kInf, kInf, 0, 0.2, false, false,
                        "position of the surface along its normal"}},
        .family = "environment",
        .confused_with = {"external_disturbance", "unknown_field"},
        .reference = "",
        .shows_over = Variable::kPosition,
        .options = {{"normal", {"z", "-z", "x", "-x", "y", "-y"}}, {"point", {"end_effector", "last_link"}}},
        .needs = {Need::kTravel},
    };
  }

  static Inference Inferred() {
    return {.starts = [](const Found& f) -> std::vector<Start> {
              const Values values = {
                  {"stiffness", f.c[0]}, {"damping", kDampingTime * f.c[0]}, {"height", f.shape}};
              return {{values, f.options}};
            },
            .prior = [](const std::string& field, double nominal, const EffectSpec&,
                        const JointSize&) -> std::optional<Prior> {
              if (field != "height") return {};
              return Prior{nominal, 0.2};
            }};
  }

  static constexpr double kDampingTime = 0.02;  // s: damping over stiffness, where a fit starts

  // Of an index into the values of "normal".
  static int Axis(int normal) { return normal < 2 ? 2 : normal < 4 ? 0 : 1; }
  static int Sign(int normal) { return normal % 2 == 0 ? 1 : -1; }
  // Force along the normal at distance x from the base's (or the joint's) origin.
  template <class S>
  static S Push(const S* p, const S& x, const S& rate) {
    using T = Base<S>;
    const S depth = p[2] - x;
    const S inside = Select(depth > T(0), depth, S(T(0)));
    const S force = p[0] * inside - p[1] * rate * inside / (inside + T(1e-4));
    return Select(force > T(0), force, S(T(0)));
  }
  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    using T = Base<S>;
    const S half(T(0.5));
    const T sign = T(Sign(law.option));
    law.force += sign * Push(p, S(sign * law.PositionAt(half)), S(sign * law.VelocityAt(half)));
  }
  // option: index into the values of "normal".
  template <class S>
  static void PointForce(const S* p, const S* position, const S* velocity, Base<S>, Base<S>, int option,
                         S* force) {
    using T = Base<S>;
    const int axis = Axis(option);
    const T sign = T(Sign(option));
    force[axis] += sign * Push(p, S(sign * position[axis]), S(sign * velocity[axis]));
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
