// What couples two drives: one's torque that reaches another joint (gears, belts, tendons), or a motor of a
// wrist that turns with two joints.
//
//   joints listed as i, j; κ [–]; option "form":
//
//   "torque"     τ_j += κ·τ_i,  τ_i after the actuator stage
//   "kinematic"  motor j turns with  w = q̇_j + κ·q̇_i,  and so do its friction and its rotor:
//                τ_j += f,  τ_i += κ·f,  f = −d·w − c·sign(w) − J·ẇ
//                viscous d [N·m·s/rad], coulomb c [N·m], armature J [kg·m²], all ≥ 0; the drive sticks where
//                w = 0, whatever its joints do
//
// The kinematic form has one law over w (JointLaw), solved with those of the joints (StepProgram::drives). It
// loses c·|w| + d·w², stores J·w²/2, and neither where the joints move so that w = 0. The motor's torque
// itself stays on joint j: efforts are joint torques.
#pragma once

#include <algorithm>
#include <cmath>

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct JointCoupling {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kCoupling;
  static constexpr int kKinematic = 1;                             // of option "form"
  enum Parameter { kCoefficient, kViscous, kCoulomb, kArmature };  // their order
  static constexpr int kInertiaParameter = kArmature;              // this parameter is law.inertia
  static constexpr bool WritesFriction(int option) { return option == kKinematic; }

  static EffectInfo Info() {
    using Only = ParameterInfo::Only;
    return {
        .id = "joint_coupling",
        .title = "Coupled joints",
        .stage = Stage::kTransmission,
        .scope = Scope::kJointPair,
        .equation = "tau_j += kappa*tau_i",
        .sentence = "{coefficient} times the torque of the first joint of {joint} reaches the second.",
        .parameters = {{"coefficient", "kappa", "-", "-", -kInf, kInf, 0, 0.1, false, false,
                        "share that reaches the second joint, or of the first joint's motion in its motor's"},
                       {"viscous", "d", "N*m*s/rad", "N*s/m", 0, kInf, 0, 0.1, true, false,
                        "viscous coefficient of the second joint's drive", Only::kBoth, "kinematic"},
                       {"coulomb", "c", "N*m", "N", 0, kInf, 0, 0.1, true, false,
                        "Coulomb level of the second joint's drive", Only::kBoth, "kinematic"},
                       {"armature", "J", "kg*m^2", "kg", 0, kInf, 0, 0.1, false, false,
                        "reflected inertia of the second joint's rotor", Only::kBoth, "kinematic"}},
        .family = "coupling",
        .confused_with = {"unknown_field", "torque_gain"},
        .reference = "",
        .shows_over = Variable::kEffort,
        .options = {{"form", {"torque", "kinematic"}}},
        .forms = {{"form", "kinematic",
                   "tau_j += f, tau_i += kappa*f, f = -d*w - c*sign(w) - J*dw, w = dq_j + kappa*dq_i",
                   "The motor of the second joint of {joint} turns with it and with {coefficient} times the "
                   "first: its friction ({viscous}, {coulomb}) and its rotor ({armature}) act on both.",
                   Variable::kVelocity}},
        .needs = {Need::kOtherEffort},
    };
  }

  static Inference Inferred() {
    return {.terms = {{Regressor::kOtherEffort, {"coefficient"}}},
            .prior = [](const std::string& field, double nominal, const EffectSpec& spec,
                        const JointSize& joint) -> std::optional<Prior> {
              if (field != "coefficient") return {};
              if (spec.options.count("form") > 0 && spec.options.at("form") == "kinematic")
                return Prior{nominal, std::max(0.1, 0.5 * std::abs(nominal)), -10, 10};
              return Prior{0, 0.5 * joint.torque / std::max(1e-9, joint.torque) + 0.1, -3, 3};
            }};
  }

  // Torque form: on the program of joint j; law.coupled is tau_i. Kinematic form: on that of the drive, whose
  // velocity is w.
  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    if (law.option == kKinematic) {
      law.viscous += p[kViscous];
      law.level_positive += p[kCoulomb];
      law.level_negative += p[kCoulomb];
      law.inertia += p[kArmature];
    } else {
      law.drive += p[kCoefficient] * law.coupled;
    }
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
