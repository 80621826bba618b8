// Evaluates the joints' scalar laws (effects/joint_law.h): forces and slopes for the velocity solver,
// gradients by all local variables for sensitivities. One text for both: Law() over the scalar.
#pragma once

#include "common/effects/effect_list.h"
#include "common/integrators/step_program.h"

namespace rg::integrators {
inline namespace RG_ISA {

using effects::Dual;
using effects::JointLaw;

// How positions follow velocities within the step, and where forces are taken.
struct Scheme {
  bool first_order;    // semi-implicit Euler: q⁺ = q + h v⁺, weights 1
  bool instantaneous;  // no step: force at (q, v), for explicit integrators
};

struct LawContext {
  const StepProgram* program;
  const StepValues* values;
  const StepInput* input;
  Scheme scheme;
  const double* mass;  // n, inertia each joint's force sees
  const bool* rough;   // n, see JointLaw
};

template <class S>
void RunOps(const StepProgram& program, int begin, int end, const S* parameters, const S* z0, S* z1,
            JointLaw<S>& law) {
  for (int k = begin; k < end; ++k) {
    const LawOp& op = program.ops[k];
    law.option = op.option;
    law.z0 = z0 + op.state;
    law.z1 = z1 + op.state;
    const S* p = parameters + op.parameter;
    effects::WithEffectType(op.kind, [&]<class E>() {
      if constexpr (requires { E::Apply(p, law); }) E::Apply(p, law);
    });
  }
}

// Force on joint i. v1, q0 …: the local variables; parameters: all of the joint's; z0, z1: its states.
// `drive`: the torque after the actuator stage, which coupled joints feel.
template <class S>
S Law(const LawContext& c, int i, const S& v1, const S& v0, const S& q0, const S& u, const S& coupled,
      const S* z0, const S* parameters, S* z1, S* drive) {
  const StepProgram& program = *c.program;
  const JointProgram& joint = program.joints[i];
  const double h = c.scheme.instantaneous ? 0.0 : c.input->h;
  JointLaw<S> law;
  law.step = {h, c.input->t, c.scheme.first_order,
              c.scheme.instantaneous ? c.values->rk4_sign_width : c.values->stick_velocity};
  law.mass = c.mass[i];
  law.reference_mass = c.values->reference_mass[i];
  law.rough = c.rough[i];
  law.q0 = q0;
  law.v0 = v0;
  law.v1 = v1;
  law.q1 = c.scheme.first_order ? q0 + h * v1 : q0 + (0.5 * h) * (v0 + v1);
  law.acceleration = c.scheme.instantaneous ? S(0.0) : (v1 - v0) * (1.0 / c.input->h);
  law.coupled = coupled;
  law.drive = parameters[kForceGain] * u;
  law.viscous = parameters[kDamping];
  law.level_positive = law.level_negative = parameters[kFriction];
  const int actuators = joint.first_op + joint.num_actuator_ops;
  RunOps(program, joint.first_op, actuators, parameters, z0, z1, law);
  *drive = law.drive;
  int next = actuators;
  for (; next < joint.first_op + joint.num_ops && joint.coupled_to >= 0 && next == actuators; ++next) {
    RunOps(program, next, next + 1, parameters, z0, z1, law);  // the coupling
  }
  law.link = law.drive;
  RunOps(program, next, joint.first_op + joint.num_ops, parameters, z0, z1, law);
  return law.Force();
}

// What the local variable kCoupled is on a joint without a coupling.
inline double Seen(const LawContext& c, int joint) {
  const int other = c.program->joints[joint].sees;
  if (other < 0) return 0.0;
  const double ahead = c.scheme.instantaneous ? 0.0 : 0.5 * c.input->h;
  return c.input->q[other] + ahead * c.input->v[other];
}

// Forces F (n) and slopes dF/dv1 (n) at end velocities v1; z1 (num_states) is written too.
inline void Forces(const LawContext& c, const double* v1, double* force, double* slope, double* z1) {
  using S = Dual<double, 1>;
  const StepProgram& program = *c.program;
  const int n = program.tree.n;
  double drives[kMaxJoints];
  // Joints that others are coupled to come first.
  for (int pass = 0; pass < 2; ++pass) {
    for (int i = 0; i < n; ++i) {
      const JointProgram& joint = program.joints[i];
      if ((joint.coupled_to >= 0) != (pass == 1)) continue;
      S parameters[kMaxLocals], z[kMaxLocals], end[kMaxLocals], drive;
      const double* values = c.values->joint_parameters + joint.first_parameter;
      for (int k = 0; k < joint.num_parameters; ++k) parameters[k] = S(values[k]);
      for (int k = 0; k < joint.num_states; ++k) z[k] = S(c.input->z[joint.first_state + k]);
      const S coupled(pass == 1 ? drives[joint.coupled_to] : Seen(c, i));
      const S f = Law<S>(c, i, S::Variable(v1[i], 0), S(c.input->v[i]), S(c.input->q[i]),
                         S(c.input->command[i]), coupled, z, parameters, end, &drive);
      force[i] = f.v;
      slope[i] = f.d[0];
      drives[i] = drive.v;
      for (int k = 0; k < joint.num_states; ++k) z1[joint.first_state + k] = end[k].v;
    }
    bool any = false;
    for (int i = 0; i < n; ++i) any |= program.joints[i].coupled_to >= 0;
    if (!any) break;
  }
}

// Gradients by local variables: of the force, of the drive torque, of each internal state's end value.
struct LawGradients {
  double force[kMaxJoints][kMaxLocals];
  double drive[kMaxJoints][kMaxLocals];
  double state[kMaxJoints * 4][kMaxLocals];  // row first_state + k
  double drive_value[kMaxJoints];
};

template <int W>
void JointGradient(const LawContext& c, int i, double v1, double coupled, LawGradients* out) {
  using S = Dual<double, W>;
  const JointProgram& joint = c.program->joints[i];
  S parameters[W], z[W], end[W], drive;
  const double* values = c.values->joint_parameters + joint.first_parameter;
  for (int k = 0; k < joint.num_states; ++k) {
    z[k] = S::Variable(c.input->z[joint.first_state + k], kFirstState + k);
  }
  for (int k = 0; k < joint.num_parameters; ++k) {
    parameters[k] = S::Variable(values[k], kFirstState + joint.num_states + k);
  }
  const S f = Law<S>(c, i, S::Variable(v1, kEndVelocity), S::Variable(c.input->v[i], kVelocity),
                     S::Variable(c.input->q[i], kPosition), S::Variable(c.input->command[i], kCommand),
                     S::Variable(coupled, kCoupled), z, parameters, end, &drive);
  const int locals = joint.num_locals();
  out->drive_value[i] = drive.v;
  for (int k = 0; k < locals; ++k) {
    out->force[i][k] = f.d[k];
    out->drive[i][k] = drive.d[k];
  }
  for (int s = 0; s < joint.num_states; ++s) {
    for (int k = 0; k < locals; ++k) out->state[joint.first_state + s][k] = end[s].d[k];
  }
}

inline void Gradients(const LawContext& at, const Directions& directions, const double* v1,
                      LawGradients* out) {
  const int n = at.program->tree.n;
  // A friction level of zero changes no force, but it has a derivative.
  bool rough[kMaxJoints];
  for (int i = 0; i < n; ++i) rough[i] = at.rough[i] || directions.friction[i];
  LawContext c = at;
  c.rough = rough;
  for (int pass = 0; pass < 2; ++pass) {
    for (int i = 0; i < n; ++i) {
      const JointProgram& joint = c.program->joints[i];
      if ((joint.coupled_to >= 0) != (pass == 1)) continue;
      const double coupled = pass == 1 ? out->drive_value[joint.coupled_to] : Seen(c, i);
      const int locals = joint.num_locals();
      if (locals <= 8) {
        JointGradient<8>(c, i, v1[i], coupled, out);
      } else if (locals <= 16) {
        JointGradient<16>(c, i, v1[i], coupled, out);
      } else if (locals <= 32) {
        JointGradient<32>(c, i, v1[i], coupled, out);
      } else {
        JointGradient<kMaxLocals>(c, i, v1[i], coupled, out);
      }
    }
  }
}

}  // namespace RG_ISA
}  // namespace rg::integrators
