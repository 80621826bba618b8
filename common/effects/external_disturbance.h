// Something pushes the robot for a while.
//
//   with joints:  tau = torque          for start ≤ t < end, on those joints      torque [N·m]
//   without:      f = (force_x, force_y, force_z) on a point, base frame [N]
//
// The point is the origin of the end-effector link, or of the child link of the last joint (option "point").
// t is the state's time. Averaged over each step, so that start and end have derivatives.
#pragma once

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"
#include "common/effects/inference.h"
#include "common/effects/joint_law.h"

namespace rg::effects {
inline namespace RG_ISA {

struct ExternalDisturbance {
  static constexpr Role kRole = Role::kJointOrPointForce;
  static constexpr Phase kPhase = Phase::kJoint;

  static EffectInfo Info() {
    return {
        .id = "external_disturbance",
        .title = "External disturbance",
        .stage = Stage::kEnvironment,
        .scope = Scope::kJointOrRobot,
        .equation = "tau += d for start <= t < end",
        .sentence = "Something else acts on {joint} from {start} to {end}.",
        .parameters = {{"start", "t0", "s", "s", -kInf, kInf, 0, 1, false, false, "begin"},
                       {"end", "t1", "s", "s", -kInf, kInf, 0, 1, false, false, "end"},
                       {"torque", "d", "N*m", "N", -kInf, kInf, 0, 0.2, true, false, "torque on the joint",
                        ParameterInfo::Only::kWithJoints},
                       {"force_x", "f_x", "N", "N", -kInf, kInf, 0, 10, false, false,
                        "force on the end effector", ParameterInfo::Only::kWithoutJoints},
                       {"force_y", "f_y", "N", "N", -kInf, kInf, 0, 10, false, false,
                        "force on the end effector", ParameterInfo::Only::kWithoutJoints},
                       {"force_z", "f_z", "N", "N", -kInf, kInf, 0, 10, false, false,
                        "force on the end effector", ParameterInfo::Only::kWithoutJoints}},
        .family = "environment",
        .confused_with = {"contact", "unknown_field"},
        .reference = "",
        .shows_over = Variable::kTime,
        .options = {{"point", {"end_effector", "last_link"}}},
    };
  }

  static Inference Inferred() {
    return {.terms = {{Regressor::kPulse, {"torque"}}},
            .starts = [](const Found& f) -> std::vector<Start> {
              return {{{{"start", f.shape}, {"end", f.shape_end}, {"torque", f.c[0]}}}};
            },
            .prior = [](const std::string& field, double nominal, const EffectSpec&,
                        const JointSize& joint) -> std::optional<Prior> {
              if (field == "torque") return Prior{0, joint.torque};
              if (field == "start" || field == "end") return Prior{nominal, 0.4};
              return Prior{0, 0.5 * joint.torque / 0.3};
            }};
  }

  template <class S>
  static void Apply(const S* p, JointLaw<S>& law) {
    law.force += Share(p, law.step.t, law.step.t + law.step.h) * p[2];
  }
  template <class S, class T>
  static void PointForce(const S* p, const S*, const S*, T begin, T end, int, S* force) {
    const S share = Share(p, begin, end);
    for (int i = 0; i < 3; ++i) force[i] += share * p[3 + i];
  }
  // Part of [begin, end] that lies in [start, end of the disturbance).
  template <class S, class T>
  static S Share(const S* p, T begin, T end) {
    if (!All(end > begin)) return Select(p[0] > begin, S(T(0)), Select(p[1] > begin, S(T(1)), S(T(0))));
    const S from = Select(p[0] > begin, p[0], S(begin)), to = Select(p[1] < end, p[1], S(end));
    const S length = to - from;
    return Select(length > T(0), length, S(T(0))) / (end - begin);
  }
};

}  // namespace RG_ISA
}  // namespace rg::effects
