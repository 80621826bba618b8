// Classical Runge-Kutta of fourth order, explicit: for smooth plants without internal states, whose
// damping the step resolves (h·d/M well below 2.7). Sign functions are smoothed (StepValues::rk4_sign_width).
//
//   k_s = (v_s, a(q_s, v_s)),  s = 1…4 at 0, h/2, h/2, h;   x⁺ = x + h/6·(k_1 + 2 k_2 + 2 k_3 + k_4)
#pragma once

#include "common/integrators/step_sensitivity.h"

namespace rg::integrators {
inline namespace RG_ISA {

// s.v1 = acceleration at (q, v) under the laws' instantaneous forces; leaves w ready for Derivatives.
template <int C>
StepResult Acceleration(const LawContext& c, const double* q, const double* v, bool derivatives,
                        StepWorkspace<C>& s) {
  const StepProgram& program = *c.program;
  const dynamics::Tree& tree = program.tree;
  const int n = tree.n;
  dynamics::CopyIn(n, q, s.w.q);
  dynamics::Kinematics(tree, s.w);
  BiasHere(tree, c.values->gravity, v, s);
  dynamics::CompositeForces(tree, s.w);
  dynamics::MassMatrix(tree, s.w);
  PointForces(program, *c.values, v, c.input->t, c.input->t, derivatives, s);
  Forces(c, v, s.force, s.slope, s.z1);
  LoadMass(n, 1.0, s, s.H);
  for (int i = 0; i < n; ++i) {
    s.H[i * C + i] += s.armature[i];
    s.v1[i] = s.force[i] + s.E[i] - s.w.c[i];
  }
  const int bad = Cholesky<C>(n, s.H, s.diagonal);
  if (bad >= 0) return {StepStatus::kMassMatrixNotPositive, bad};
  CholeskySolve<C>(n, s.H, s.diagonal, s.v1);
  for (int i = 0; i < n; ++i) {
    if (!(__builtin_fabs(s.v1[i]) < 1e300)) return {StepStatus::kNonFinite, i};
  }
  return {};
}

// da = H⁻¹(B_q dq + B_v dv + direct) of one stage; dq, dv, da: n × stride.
template <int C>
bool StageSensitivity(const LawContext& c, const Directions& directions, StepWorkspace<C>& s, double* direct,
                      const double* dq, const double* dv, double* da) {
  const StepProgram& program = *c.program;
  const int n = program.tree.n, stride = directions.stride;
  dynamics::SetAcceleration(program.tree, s.v1, s.w);
  dynamics::Derivatives(program.tree, s.w);
  dynamics::Regressor(program.tree, s.w);
  Gradients(c, directions, c.input->v, &s.gradients);
  // The laws saw no acceleration: a rotor inertia's own derivative is −a.
  for (int i = 0; i < n; ++i) {
    const JointProgram& joint = program.joints[i];
    for (int k = joint.first_op; k < joint.first_op + joint.num_ops; ++k) {
      effects::WithEffectType(program.ops[k].kind, [&]<class E>() {
        if constexpr (requires { E::kInertiaParameter; }) {
          const int local = kFirstState + joint.num_states + program.ops[k].parameter + E::kInertiaParameter;
          s.gradients.force[i][local] -= s.v1[i];
        }
      });
    }
  }
  DirectForces(c, directions, s, direct);
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      s.H[i * C + j] = s.w.M[j][i];
      s.B_q[i * C + j] = -s.w.dtau_dq[j][i];
      s.B_v[i * C + j] = -s.w.dtau_dv[j][i];
      if (program.num_point_forces > 0) {
        s.B_q[i * C + j] += s.E_q[i * C + j];
        s.B_v[i * C + j] += s.E_v[i * C + j];
      }
    }
    s.H[i * C + i] += s.armature[i];
    s.B_q[i * C + i] += s.gradients.force[i][kPosition];
    s.B_v[i * C + i] += s.gradients.force[i][kVelocity] + s.gradients.force[i][kEndVelocity];
    if (const int other = program.joints[i].sees; other >= 0)
      s.B_q[i * C + other] += s.gradients.force[i][kCoupled];
    const int source = program.joints[i].coupled_to;
    if (source >= 0) {
      const double slope = s.gradients.force[i][kCoupled];
      const double* drive = s.gradients.drive[source];
      s.B_q[i * C + source] += slope * drive[kPosition];
      s.B_v[i * C + source] += slope * (drive[kVelocity] + drive[kEndVelocity]);
    }
  }
  if (!Invert<C>(n, s.H)) return false;
  for (int k = 0; k < stride; ++k) {
    double rhs[C];
    for (int i = 0; i < n; ++i) {
      rhs[i] = direct[i * stride + k];
      for (int j = 0; j < n; ++j) {
        rhs[i] += s.B_q[i * C + j] * dq[j * stride + k] + s.B_v[i * C + j] * dv[j * stride + k];
      }
    }
    for (int i = 0; i < n; ++i) {
      double sum = 0;
      for (int j = 0; j < n; ++j) sum += s.H[i * C + j] * rhs[j];
      da[i * stride + k] = sum;
    }
  }
  return true;
}

// `direct`: n × stride, followed by 3·n × stride of scratch when directions are given.
template <int C>
StepResult Rk4Step(const StepProgram& program, const StepValues& values, const StepInput& input,
                   const Directions* directions, double* direct, const Sensitivity& from,
                   const Sensitivity& to, const StepOutput& output, StepWorkspace<C>& s) {
  const int n = program.tree.n;
  const double h = input.h;
  constexpr double kNode[4] = {0.0, 0.5, 0.5, 1.0};
  constexpr double kShare[4] = {1.0 / 6, 1.0 / 3, 1.0 / 3, 1.0 / 6};
  double q[C], v[C], previous_v[C], previous_a[C] = {}, sum_v[C] = {}, sum_a[C] = {};
  for (int i = 0; i < n; ++i) previous_v[i] = input.v[i];
  const int size = directions == nullptr ? 0 : n * directions->stride;
  double *dq = direct + size, *dv = dq + size, *da = dv + size;
  for (int k = 0; k < size; ++k) {
    to.q[k] = from.q[k];
    to.v[k] = from.v[k];
    dv[k] = from.v[k];
    da[k] = 0.0;
  }
  for (int stage = 0; stage < 4; ++stage) {
    const double shift = kNode[stage] * h;
    for (int i = 0; i < n; ++i) {
      q[i] = input.q[i] + shift * previous_v[i];
      v[i] = input.v[i] + shift * previous_a[i];
    }
    StepInput here = input;
    here.q = q;
    here.v = v;
    here.t = input.t + shift;
    const LawContext c{&program, &values, &here, {false, true}, s.mass, s.rough};
    const StepResult result = Acceleration(c, q, v, directions != nullptr, s);
    if (result.status != StepStatus::kOk) return result;
    for (int i = 0; i < n; ++i) {
      sum_v[i] += kShare[stage] * v[i];
      sum_a[i] += kShare[stage] * s.v1[i];
      previous_v[i] = v[i];
      previous_a[i] = s.v1[i];
    }
    if (directions == nullptr) continue;
    for (int k = 0; k < size; ++k) {
      dq[k] = from.q[k] + shift * dv[k];
      dv[k] = from.v[k] + shift * da[k];
    }
    if (!StageSensitivity(c, *directions, s, direct, dq, dv, da))
      return {StepStatus::kMassMatrixNotPositive, 0};
    for (int k = 0; k < size; ++k) {
      to.q[k] += h * kShare[stage] * dv[k];
      to.v[k] += h * kShare[stage] * da[k];
    }
  }
  for (int i = 0; i < n; ++i) {
    output.q[i] = input.q[i] + h * sum_v[i];
    output.v[i] = input.v[i] + h * sum_a[i];
  }
  return {};
}

}  // namespace RG_ISA
}  // namespace rg::integrators
