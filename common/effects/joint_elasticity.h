// A motor that drives the link through a spring (strain-wave gear, belt, long shaft).
//
//   J·ω̇ = tau_drive − T,   T = k·(θ − q) + b·(ω − v)  acts on the link
//   k [N·m/rad] > 0, b [N·m·s/rad] ≥ 0, J [kg·m²] > 0 motor inertia seen at the joint;  states θ, ω
//
// The motor's equation is linear in its end-of-step velocity, so it is solved here for any v1: the rest
// of the step sees a force on the link. Stiff springs need no small step. Option "sensor" says on which
// side the encoder sits.
// Ref: Spong, J. Dyn. Sys. 109(4), 1987.
#pragma once

#include <algorithm>
#include <cmath>

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct JointElasticity {
  static constexpr Role kRole = Role::kJointLaw;
  static constexpr Phase kPhase = Phase::kTransmission;
  static constexpr int kStates = 2;
  static constexpr const char* kStateNames[] = {"motor_position", "motor_velocity"};

  static EffectInfo Info() {
    return {
        .id = "joint_elasticity",
        .title = "Elastic joint",
        .stage = Stage::kTransmission,
        .scope = Scope::kJoint,
        .equation = "tau = k*(theta-q) + b*(dtheta-dq), J*ddtheta = u - tau",
        .sentence =
            "{joint} is elastic: motor and link are joined by a spring of {stiffness} that the model does "
            "not have.",
        .parameters = {{"stiffness", "k", "N*m/rad", "N/m", 1e-3, kInf, 1e4, 1e4, false, false, "stiffness"},
                       {"damping", "b", "N*m*s/rad", "N*s/m", 0, kInf, 1, 5, false, false,
                        "damping of the spring"},
                       {"motor_inertia", "J", "kg*m^2", "kg", 1e-6, kInf, 0.1, 0.1, false, false,
                        "motor inertia at the joint"}},
        .family = "compliance",
        .confused_with = {"backlash", "base_flexibility", "presliding_hysteresis"},
        .reference = "Spong, J. Dyn. Sys. 109(4), 1987",
        .options = {{"sensor", {"link", "motor"}}},
        .needs = {Need::kResonances, Need::kAcceleration},
    };
  }

  static Inference Inferred() {
    return {
        .terms = {{Regressor::kSprungRotor, {"motor_inertia"}, true}, {Regressor::kThroughSpring}},
        .shape = "stiffness",
        .needs_fit = true,
        .coefficient = Inference::Near::kOneOrBelowLast,
        .slot = Slot::kTransmission,
        .probe = Probe::kVibration,
        .starts = [](const Found& f) -> std::vector<Start> {
          const double J = std::max(f.c[0], 0.02 * f.joint.inertia);
          return {
              {{{"stiffness", J * f.shape * f.shape}, {"damping", 0.2 * J * f.shape}, {"motor_inertia", J}},
               {{"sensor", "link"}}}};
        },
        .blind = Springs,
        .instead = [](const Values& play, Blind) -> std::vector<Start> {
          return {{{{"stiffness", play.at("contact_stiffness")},
                    {"damping", play.at("contact_damping")},
                    {"motor_inertia", play.at("motor_inertia")}}}};
        },
        .rotor = "motor_inertia",
        .prior = [](const std::string& field, double, const EffectSpec&,
                    const JointSize& joint) -> std::optional<Prior> {
          if (field != "motor_inertia") return {};
          return Prior{0.3 * joint.inertia, joint.inertia, 0.002 * joint.inertia, 10 * joint.inertia};
        }};
  }
  // From soft to stiff.
  static std::vector<Start> Springs(const Blind& b) {
    std::vector<Start> out;
    const double inertia = b.joint.inertia;
    for (const double J : b.rotors) {
      const double lighter = J * inertia / (J + inertia);
      for (const double hertz : {5.0, 9.0, 16.0, 30.0}) {
        const double omega = 2 * M_PI * hertz, k = omega * omega * lighter;
        out.push_back({{{"stiffness", k}, {"damping", 0.2 * std::sqrt(k * lighter)}, {"motor_inertia", J}}});
      }
    }
    return out;
  }

  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    using T = Base<S>;
    const T h = law.step.h;
    const S &k = p[0], &b = p[1], &J = p[2], &theta0 = law.z0[0], &omega0 = law.z0[1];
    const S lighter = J * law.reference_mass / (J + law.reference_mass);
    const S weight = law.OscillationWeight(k * (h * h) / lighter);
    const T drift = law.step.first_order ? T(1) : T(0.5);
    const S rest =
        k * (theta0 + weight * h * omega0 - law.PositionAt(weight)) + b * (omega0 - law.VelocityAt(weight));
    const S slope = weight * (k * (h * drift) + b);  // of T by the change of ω
    const S change = (law.drive - rest) / (J / h + slope);
    law.link = rest + slope * change;
    law.z1[0] = theta0 + h * (omega0 + drift * change);
    law.z1[1] = omega0 + change;
  }

  // The motor turned so far that the spring holds the drive's torque.
  static void Settle(const double* p, const JointLaw<double>& law, double* z) {
    z[0] = law.q0 + law.drive / p[0];
    z[1] = law.v0;
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
