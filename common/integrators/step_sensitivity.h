// Forward sensitivities of one implicit step by the implicit function theorem at its solution: no tape,
// no differences. With A_q, A_v the derivatives of inverse dynamics at (q_s, v_s, a = (v1 − v0)/h),
//
//   (M/h + w1·A_v − dF/dv1) dv1 = (M/h − w0·A_v + dF/dv0) dv0 − A_q dq_s + dF/dq0 dq0 + dF/dz dz0
//                                 − Y dφ − dtau/dg dg + dF/dp dp + dF/du du
//
// A column of the state's sensitivity is one direction; most parameters of a robot share few directions
// (ten per body), and sim/ maps directions to parameters at the outputs.
#pragma once

#include "common/integrators/step_workspace.h"

namespace rg::integrators {
inline namespace RG_ISA {

// Where a step takes its rigid-body terms.
struct StepWeights {
  double position;  // q_s = q0 + position · v0
  double begin;     // v_s = begin · v0 + end · v1
  double end;
};

// Direct effect of every direction on the generalised force, n × stride into `direct`; only columns that
// have one are written (the rest stays zero). With coupling, of the source's parameters too.
template <int C>
void DirectForces(const LawContext& c, const Directions& directions, const StepWorkspace<C>& s,
                  double* direct) {
  const StepProgram& program = *c.program;
  const int n = program.tree.n, stride = directions.stride;
  if (directions.gravity >= 0) {
    for (int i = 0; i < n; ++i) {
      double* row = direct + i * stride + directions.gravity;
      row[0] = s.w.F.lin.x[i];
      row[1] = s.w.F.lin.y[i];
      row[2] = s.w.F.lin.z[i];
    }
  }
  for (int b = 0; b < n; ++b) {
    for (int k = 0; k < directions.num_body[b]; ++k) {
      const double* basis = directions.basis[b] + 10 * k;
      double* column = direct + directions.first_body[b] + k;
      double sum[C] = {};
      for (int m = 0; m < 10; ++m) {
        const double weight = basis[m];
        if (weight == 0.0) continue;
        for (int i = 0; i < C; ++i) sum[i] -= weight * s.w.Y[b][m][i];
      }
      for (int i = 0; i <= b; ++i) column[i * stride] = sum[i];
    }
  }
  // Several joints may share a parameter, several columns a joint.
  for (int k = 0; k < directions.num_locals; ++k) {
    const auto& l = directions.locals[k];
    for (int i = 0; i < n; ++i) direct[i * stride + l.column] = 0.0;
  }
  for (int k = 0; k < directions.num_commands; ++k) {
    const auto& l = directions.commands[k];
    for (int i = 0; i < n; ++i) direct[i * stride + l.column] = 0.0;
  }
  auto add = [&](int joint, int local, int column, double weight) {
    direct[joint * stride + column] += weight * s.gradients.force[joint][local];
    for (int j = 0; j < n; ++j) {
      if (program.joints[j].coupled_to != joint) continue;
      direct[j * stride + column] +=
          weight * s.gradients.force[j][kCoupled] * s.gradients.drive[joint][local];
    }
  };
  for (int k = 0; k < directions.num_locals; ++k) {
    const auto& l = directions.locals[k];
    add(l.joint, l.local, l.column, 1.0);
  }
  for (int k = 0; k < directions.num_commands; ++k) {
    const auto& l = directions.commands[k];
    add(l.joint, kCommand, l.column, l.weight);
  }
  for (int k = 0; k < directions.num_points; ++k) {
    const auto& point = directions.points[k];
    for (int i = 0; i < n; ++i) {
      direct[i * stride + point.column] = s.E_p[point.force * kMaxPointParameters + point.parameter][i];
    }
  }
}

// H⁻¹ into s.H, and the matrices that dq0 and dv0 are multiplied with into s.B_q, s.B_v, all row-major C.
template <int C>
bool StateMatrices(const LawContext& c, const StepWeights& weights, StepWorkspace<C>& s) {
  const StepProgram& program = *c.program;
  const int n = program.tree.n;
  const double inverse_h = 1.0 / c.input->h;
  const bool points = program.num_point_forces > 0;
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < C; ++j) {
      const double m = s.w.M[j][i] * inverse_h;
      double A_q = s.w.dtau_dq[j][i], A_v = s.w.dtau_dv[j][i];
      if (points && j < n) {
        A_q -= s.E_q[i * C + j];
        A_v -= s.E_v[i * C + j];
      }
      s.H[i * C + j] = m + weights.end * A_v;
      s.B_q[i * C + j] = -A_q;
      s.B_v[i * C + j] = m - weights.begin * A_v - weights.position * A_q;
    }
    s.H[i * C + i] -= s.gradients.force[i][kEndVelocity];
    s.B_q[i * C + i] += s.gradients.force[i][kPosition];
    s.B_v[i * C + i] += s.gradients.force[i][kVelocity];
    if (const int other = program.joints[i].sees; other >= 0) {
      const double slope = s.gradients.force[i][kCoupled];
      s.B_q[i * C + other] += slope;
      s.B_v[i * C + other] += 0.5 * c.input->h * slope;
    }
    const int source = program.joints[i].coupled_to;
    if (source >= 0) {
      const double slope = s.gradients.force[i][kCoupled];
      s.H[i * C + source] -= slope * s.gradients.drive[source][kEndVelocity];
      s.B_q[i * C + source] += slope * s.gradients.drive[source][kPosition];
      s.B_v[i * C + source] += slope * s.gradients.drive[source][kVelocity];
    }
  }
  return Invert<C>(n, s.H);
}

// Solves for dv1 and moves all columns to the step's end. q1 = q0 + position_begin·v0 + position_end·v1.
template <int C>
void Propagate(const LawContext& c, const Directions& directions, double position_begin, double position_end,
               const StepWorkspace<C>& s, const double* direct, const Sensitivity& from,
               const Sensitivity& to) {
  using P = math::Lanes<8>;
  const StepProgram& program = *c.program;
  const int n = program.tree.n, stride = directions.stride;
  auto load = [](const double* p) RG_LAMBDA_INLINE {
    return P(*reinterpret_cast<const P::Vector*>(__builtin_assume_aligned(p, 64)));
  };
  auto store = [](double* p, P x)
                   RG_LAMBDA_INLINE { *reinterpret_cast<P::Vector*>(__builtin_assume_aligned(p, 64)) = x.v; };
  for (int block = 0; block < stride; block += 8) {
    P q[C], v[C], rhs[C];
    for (int j = 0; j < n; ++j) {
      q[j] = load(from.q + j * stride + block);
      v[j] = load(from.v + j * stride + block);
    }
    for (int i = 0; i < n; ++i) {
      P sum = load(direct + i * stride + block);
      for (int j = 0; j < n; ++j) sum += q[j] * P(s.B_q[i * C + j]) + v[j] * P(s.B_v[i * C + j]);
      const JointProgram& joint = program.joints[i];
      for (int k = 0; k < joint.num_states; ++k) {
        sum += load(from.z + (joint.first_state + k) * stride + block) *
               P(s.gradients.force[i][kFirstState + k]);
      }
      const int source = joint.coupled_to;
      if (source >= 0) {
        const JointProgram& other = program.joints[source];
        for (int k = 0; k < other.num_states; ++k) {
          sum += load(from.z + (other.first_state + k) * stride + block) *
                 P(s.gradients.force[i][kCoupled] * s.gradients.drive[source][kFirstState + k]);
        }
      }
      rhs[i] = sum;
    }
    for (int i = 0; i < n; ++i) {
      P v1(0.0);
      for (int j = 0; j < n; ++j) v1 += rhs[j] * P(s.H[i * C + j]);
      const JointProgram& joint = program.joints[i];
      for (int k = 0; k < joint.num_states; ++k) {
        const double* slope = s.gradients.state[joint.first_state + k];
        P sum = v1 * P(slope[kEndVelocity]) + v[i] * P(slope[kVelocity]) + q[i] * P(slope[kPosition]);
        for (int m = 0; m < joint.num_states; ++m) {
          sum += load(from.z + (joint.first_state + m) * stride + block) * P(slope[kFirstState + m]);
        }
        store(to.z + (joint.first_state + k) * stride + block, sum);
      }
      store(to.v + i * stride + block, v1);
      store(to.q + i * stride + block, q[i] + v[i] * P(position_begin) + v1 * P(position_end));
    }
  }
  for (int k = 0; k < directions.num_locals; ++k) {
    const auto& l = directions.locals[k];
    const JointProgram& joint = program.joints[l.joint];
    for (int m = 0; m < joint.num_states; ++m) {
      to.z[(joint.first_state + m) * stride + l.column] += s.gradients.state[joint.first_state + m][l.local];
    }
  }
  for (int k = 0; k < directions.num_commands; ++k) {
    const auto& l = directions.commands[k];
    const JointProgram& joint = program.joints[l.joint];
    for (int m = 0; m < joint.num_states; ++m) {
      to.z[(joint.first_state + m) * stride + l.column] +=
          l.weight * s.gradients.state[joint.first_state + m][kCommand];
    }
  }
}

}  // namespace RG_ISA
}  // namespace rg::integrators
