// A gear with play: the motor moves through a gap before it pushes the link.
//
//   J·ω̇ = tau_drive − c·ω − T,  with δ = θ − q and half the gap s = gap/2:
//   T = k·(δ − s) + b·δ̇ ≥ 0 for δ > s,   0 inside the gap,   k·(δ + s) + b·δ̇ ≤ 0 for δ < −s
//   k [N·m/rad] > 0, b [N·m·s/rad] ≥ 0, J [kg·m²] > 0, c [N·m·s/rad] ≥ 0;  states θ, ω
//
// The faces push, they never pull. Damping grows over the first 0.1 % of the gap (at least 1e-6 rad), so
// that T has no jump. The motor's end-of-step velocity is eliminated as in joint_elasticity.h.
// Ref: Nordin, Gutman, Automatica 38(10), 2002.
#pragma once

#include <cmath>

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct Backlash {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kTransmission;
  static constexpr int kStates = 2;
  static constexpr const char* kStateNames[] = {"motor_position", "motor_velocity"};

  static EffectInfo Info() {
    return {
        .id = "backlash",
        .title = "Backlash",
        .stage = Stage::kTransmission,
        .scope = Scope::kJoint,
        .equation =
            "tau = k*(delta -+ gap/2) + b*ddelta beyond the gap, 0 inside; J*ddtheta = u - c*dtheta - tau",
        .sentence = "{joint} has play: its motor moves through {gap} before it pushes the link.",
        .parameters = {{"gap", "gap", "rad", "m", 0, kInf, 0.01, 0.02, false, false, "total play"},
                       {"contact_stiffness", "k", "N*m/rad", "N/m", 1e-3, kInf, 1e4, 1e4, false, false,
                        "stiffness of the faces"},
                       {"contact_damping", "b", "N*m*s/rad", "N*s/m", 0, kInf, 5, 5, false, false,
                        "damping of the faces"},
                       {"motor_inertia", "J", "kg*m^2", "kg", 1e-6, kInf, 0.1, 0.1, false, false,
                        "motor inertia at the joint"},
                       {"motor_viscous", "c", "N*m*s/rad", "N*s/m", 0, kInf, 0, 1, false, false,
                        "viscous friction of the motor"}},
        .family = "compliance",
        .confused_with = {"joint_elasticity", "base_flexibility", "presliding_hysteresis"},
        .reference = "Nordin, Gutman, Automatica 38(10), 2002",
        .options = {{"sensor", {"link", "motor"}}},
        .needs = {Need::kResonances, Need::kEffortSign},
    };
  }

  static Inference Inferred() {
    return {.slot = Slot::kTransmission,
            .probe = Probe::kSlowRamps,
            .blind = Gaps,
            .instead =
                [](const Values& spring, Blind with) {
                  with.rotors = {spring.at("motor_inertia")};
                  return Gaps(with);
                },
            .stays = "gap",
            .prior = [](const std::string& field, double, const EffectSpec&,
                        const JointSize& joint) -> std::optional<Prior> {
              if (field == "gap") return Prior{0, 0.05, 1e-5, 0.5};
              if (field == "motor_viscous") return Prior{0, 0.2 * joint.torque / joint.speed};
              if (field == "motor_inertia")
                return Prior{0.3 * joint.inertia, joint.inertia, 0.002 * joint.inertia, 10 * joint.inertia};
              return {};
            }};
  }
  // Soft faces: how hard they are a fit finds out, but not where motor and link meet.
  static std::vector<Start> Gaps(const Blind& b) {
    static const std::vector<double> kCoarse = {0.007, 0.02, 0.06, 0.16};
    static const std::vector<double> kFine = {0.005, 0.009, 0.016, 0.03, 0.055, 0.1, 0.18};
    std::vector<Start> out;
    const double inertia = b.joint.inertia, omega = 2 * M_PI * 12.0, k = omega * omega * inertia;
    for (const double J : b.rotors) {
      for (const double share : b.fine ? kFine : kCoarse) {
        out.push_back({{{"gap", share * b.joint.Range()},
                        {"contact_stiffness", k},
                        {"contact_damping", 0.3 * std::sqrt(k * inertia)},
                        {"motor_inertia", J}}});
      }
    }
    return out;
  }

  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    using T = Base<S>;
    const T h = law.step.h;
    const S &k = p[1], &c = p[4], &theta0 = law.z0[0], &omega0 = law.z0[1];
    const S half = T(0.5) * p[0];
    const S J = p[3] + T(0.5) * h * c;  // the motor's friction at the middle of the step
    const S lighter = J * law.reference_mass / (J + law.reference_mass);
    const S weight = law.OscillationWeight(k * (h * h) / lighter);
    const T drift = law.step.first_order ? T(1) : T(0.5);

    // Deflection and its rate at the weighted time if the motor turned freely, and what a torque takes off.
    const S free = (law.drive - c * omega0) * h / J;  // change of ω
    const S deflection = theta0 + weight * h * (omega0 + drift * free) - law.PositionAt(weight);
    const S rate = omega0 + weight * free - law.VelocityAt(weight);
    const S give = weight * (h * h * drift) / J;  // of the deflection, per torque
    const S give_rate = weight * h / J;           // of the rate, per torque

    const S side = Select(deflection < T(0), S(T(-1)), S(T(1)));
    const S depth = side * deflection - half;  // > 0: the faces touch
    const S touching = Select(depth > T(0), depth, S(T(0)));
    const S b = p[2] * touching / (touching + T(1e-3) * p[0] + T(1e-6));
    const S push = (k * touching + b * side * rate) / (T(1) + k * give + b * give_rate);
    law.link = side * Select(push > T(0), push, S(T(0)));
    const S change = free - law.link * h / J;
    law.z1[0] = theta0 + h * (omega0 + drift * change);
    law.z1[1] = omega0 + change;
  }

  // The motor on the face that the drive's torque presses.
  static void Settle(const double* p, const JointLaw<double>& law, double* z) {
    const double side = law.drive > 0 ? 1.0 : law.drive < 0 ? -1.0 : 0.0;
    z[0] = law.q0 + side * 0.5 * p[0] + law.drive / p[1];
    z[1] = law.v0;
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
