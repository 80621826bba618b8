// Forward sensitivities of one implicit step by the implicit function theorem at its solution: no tape,
// no differences. With A_q, A_v the derivatives of inverse dynamics at (q_s, v_s, a = (v1 − v0)/h),
//
//   (M/h + w1·A_v − dF/dv1) dv1 = (M/h − w0·A_v + dF/dv0) dv0 − A_q dq_s + dF/dq0 dq0 + dF/dz dz0
//                                 − Y dφ − dtau/dg dg + dF/dp dp + dF/du du
//
// A column of the sensitivities is one direction, its entries rows over joints; most parameters of a robot
// share few directions (ten per body), and sim/ maps directions to parameters at the outputs.
#pragma once

#include "common/integrators/step_workspace.h"

namespace rg::integrators {
inline namespace RG_ISA {

// Where a step takes its rigid-body terms.
template <class T>
struct StepWeights {
  T position;    // q_s = q0 + position · v0
  double begin;  // v_s = begin · v0 + end · v1
  double end;
};

// A column of sensitivities.
template <class T, int C>
struct ColumnRows {
  T* x;
  T* q() const { return x; }
  T* v() const { return x + C; }
  T* z(int k) const { return x + (2 + k) * C; }
};
template <class T, int C>
RG_INLINE ColumnRows<T, C> ColumnOf(const StepProgram& program, const Sensitivity& s, int column) {
  return {reinterpret_cast<T*>(s.columns) + static_cast<long>(column) * (2 + program.max_states) * C};
}

// Direct effect of a local variable of a coupled drive's law on the generalised force: R df + dR f.
template <class T, int C, int N>
void AddDriveDirect(const LawContext<T, C>& c, const StepWorkspace<T, C, N>& s, int law, int local, T weight,
                    T* column) {
  const int d = law - s.Joints(c.program->tree);
  const JointProgram& program = c.program->joints[law];
  const bool by_ratio = local == kFirstState + program.num_states + c.program->drives[d].ratio;
  ForEachDrive<T>(*c.program, *c.values, [&](const DriveRow<T>& r) RG_LAMBDA_INLINE {
    if (r.law != law) return;
    const T force = weight * (by_ratio ? s.by_ratio[d] : s.gradients.force[local][law]);
    column[r.joint] += force;
    column[r.other] += r.ratio * force;
    if (by_ratio) column[r.other] += weight * s.force[law];
  });
}

// Direct effect of every direction on the generalised force, [column][C] into `direct`; only columns that
// have one are written (the rest stays zero). With coupling, of the source's parameters too.
template <class T, int C, int N>
void DirectForces(const LawContext<T, C>& c, const Directions& directions, const StepWorkspace<T, C, N>& s,
                  T* direct) {
  constexpr int kWidth = math::kPackWidth<T>;
  const StepProgram& program = *c.program;
  const int n = s.Joints(program.tree);
  if (directions.gravity >= 0) {
    T* column = direct + directions.gravity * C;
    for (int r = 0; r < n; r += kWidth) {
      math::StorePack(column + r, s.w.F.lin.x.Load(r));
      math::StorePack(column + C + r, s.w.F.lin.y.Load(r));
      math::StorePack(column + 2 * C + r, s.w.F.lin.z.Load(r));
    }
  }
  for (int b = 0; b < n; ++b) {
    for (int k = 0; k < directions.num_body[b]; ++k) {
      const double* basis = directions.basis[b] + 10 * k;
      T* column = direct + (directions.first_body[b] + k) * C;
      // Where a follower folds its rows into, which may be any.
      for (int r = b + 1; r < n && program.tree.num_ties > 0; ++r) column[r] = T(0.0);
      for (int r = 0; r <= b; r += kWidth) {
        Pack<T> sum(0.0);
        for (int m = 0; m < 10; ++m) {
          if (basis[m] != 0.0) sum -= Pack<T>(basis[m]) * s.w.Y[b][m].Load(r);
        }
        math::StorePack(column + r, sum);
      }
    }
  }
  // Several joints may share a parameter, several columns a joint.
  const auto clear = [&](int column) RG_LAMBDA_INLINE {
    for (int r = 0; r < n; r += kWidth) math::StorePack(direct + column * C + r, Pack<T>(0.0));
  };
  for (int k = 0; k < directions.num_locals; ++k) clear(directions.locals[k].column);
  for (int k = 0; k < directions.num_commands; ++k) clear(directions.commands[k].column);
  const bool coupling = c.packs->num_uncoupled < c.packs->count;
  const auto add = [&](int joint, int local, int column, T weight) RG_LAMBDA_INLINE {
    if (joint >= n) return AddDriveDirect(c, s, joint, local, weight, direct + column * C);
    direct[column * C + joint] += weight * s.gradients.force[local][joint];
    if (!coupling) return;
    for (int j = 0; j < n; ++j) {
      if (program.joints[j].coupled_to != joint) continue;
      direct[column * C + j] += weight * s.gradients.force[kCoupled][j] * s.gradients.drive[local][joint];
    }
  };
  for (int k = 0; k < directions.num_locals; ++k) {
    const auto& l = directions.locals[k];
    add(l.joint, l.local, l.column, T(1.0));
  }
  for (int k = 0; k < directions.num_commands; ++k) {
    const auto& l = directions.commands[k];
    add(l.joint, kCommand, l.column, c.input->command_weights[k]);
  }
  for (int k = 0; k < directions.num_points; ++k) {
    const auto& point = directions.points[k];
    for (int i = 0; i < n; ++i) {
      direct[point.column * C + i] = s.E_p[point.force * kMaxPointParameters + point.parameter][i];
    }
  }
  if (program.all_free) return;
  for (int column = directions.first_direct; column < directions.columns; ++column) {
    FoldForces(program, direct + column * C);
    DropBoundRows(program, direct + column * C);
  }
}

// The same for joints that are not free: followers with their drivers, prescribed ones not moved by anything.
template <class T, int C, int N>
RG_INLINE void BindStateMatrices(const StepProgram& program, StepWorkspace<T, C, N>& s) {
  if (program.all_free) return;
  const int n = s.Joints(program.tree);
  for (math::Row<T, C>* A : {s.inverse, s.B_q, s.B_v}) {
    FoldMatrix<T, C>(program, n, A);
    for (int j = 0; j < n; ++j) {
      for (int i = 0; i < n; ++i) {
        if (program.joints[i].prescribed) A[j][i] = T(0.0);
      }
    }
  }
  for (int i = 0; i < n; ++i) {
    if (program.joints[i].prescribed) s.inverse[i][i] = T(1.0);
  }
  for (int i = 0; i < program.tree.num_ties; ++i) {
    const int k = program.tree.ties[i].follower;
    s.inverse[k][k] = T(1.0);
  }
}

// H⁻¹ into s.inverse, and the matrices that dq0 and dv0 are multiplied with into s.B_q, s.B_v. True where H
// has no inverse.
template <class T, int C, int N>
Mask<T> StateMatrices(const LawContext<T, C>& c, const StepWeights<T>& weights, StepWorkspace<T, C, N>& s) {
  const StepProgram& program = *c.program;
  const int n = s.Joints(program.tree);
  constexpr int kWidth = math::kPackWidth<T>;
  using P = Pack<T>;
  const auto& force = s.gradients.force;
  const P position(weights.position), begin(weights.begin), end(weights.end), inverse_h(c.input->inverse_h);
  for (int j = 0; j < n; ++j) {
    for (int r = 0; r < n; r += kWidth) {
      const P m = s.w.M[j].Load(r) * inverse_h, A_q = s.w.dtau_dq[j].Load(r), A_v = s.w.dtau_dv[j].Load(r);
      P H = m + end * A_v, B_q = -A_q, B_v = m - begin * A_v - position * A_q;
      if (j >= r && j < r + kWidth) {
        H -= AlongUnit<T>(j, r, math::LoadPack(force[kEndVelocity] + r));
        B_q += AlongUnit<T>(j, r, math::LoadPack(force[kPosition] + r));
        B_v += AlongUnit<T>(j, r, math::LoadPack(force[kVelocity] + r));
      }
      s.inverse[j].Store(r, H);
      s.B_q[j].Store(r, B_q);
      s.B_v[j].Store(r, B_v);
    }
  }
  if (program.num_point_forces > 0) {
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < n; ++j) {
        const T E_q = s.E_q[i * C + j], E_v = s.E_v[i * C + j];
        s.inverse[j][i] -= T(weights.end) * E_v;
        s.B_q[j][i] += E_q;
        s.B_v[j][i] += T(weights.begin) * E_v + weights.position * E_q;
      }
    }
  }
  for (int i = 0; i < n; ++i) {
    const T slope = force[kCoupled][i];
    if (const int other = program.joints[i].sees; other >= 0) {
      s.B_q[other][i] += slope;
      s.B_v[other][i] += T(0.5) * c.input->h * slope;
    }
    if (const int source = program.joints[i].coupled_to; source >= 0) {
      s.inverse[source][i] -= slope * s.gradients.drive[kEndVelocity][source];
      s.B_q[source][i] += slope * s.gradients.drive[kPosition][source];
      s.B_v[source][i] += slope * s.gradients.drive[kVelocity][source];
    }
  }
  ForEachDrive<T>(program, *c.values, [&](const DriveRow<T>& r) RG_LAMBDA_INLINE {
    AddDriveSquare<T, C>(r, -force[kEndVelocity][r.law], s.inverse);
    AddDriveSquare<T, C>(r, force[kPosition][r.law], s.B_q);
    AddDriveSquare<T, C>(r, force[kVelocity][r.law], s.B_v);
  });
  BindStateMatrices(program, s);
  return Invert<T, C>(n, s.inverse);
}

// X ← H⁻¹ X
template <class T, int C>
RG_INLINE void TimesInverse(int n, const math::Row<T, C>* inverse, math::Row<T, C>* X) {
  for (int j = 0; j < n; ++j) {
    math::Row<T, C> product;
    math::MatrixTimes<T, C>(n, inverse, X[j], product);
    for (int r = 0; r < n; r += math::kPackWidth<T>) X[j].Store(r, product.Load(r));
  }
}

// Columns of a matrix; in registers where those of a whole robot fit.
template <class T, int C, int N>
class MatrixColumns {
  static constexpr bool kHeld = N > 0 && N <= math::kPackWidth<T>;

 public:
  RG_INLINE explicit MatrixColumns(const math::Row<T, C>* rows) : rows_(rows) {
    if constexpr (kHeld) {
      for (int j = 0; j < N; ++j) held_[j] = rows[j].Load(0);
    }
  }
  // Entries r … of A y, y: n.
  RG_INLINE Pack<T> Times(int n, const T* y, int r) const {
    Pack<T> sum = Load(0, r) * Pack<T>(y[0]);
    for (int j = 1; j < n; ++j) sum += Load(j, r) * Pack<T>(y[j]);
    return sum;
  }

 private:
  RG_INLINE Pack<T> Load(int j, int r) const {
    if constexpr (kHeld) {
      return held_[j];
    } else {
      return rows_[j].Load(r);
    }
  }
  const math::Row<T, C>* rows_;
  Pack<T> held_[kHeld ? N : 1];
};

// v1 = B_q q + B_v v + H⁻¹ u of every column, and all of it moved to the step's end. kStates: the most
// internal states of one joint where the compiler may know them, else -1.
template <int kStates, class T, int C, int N>
void PropagateColumns(const LawContext<T, C>& c, const Directions& directions, T position_begin,
                      T position_end, const StepWorkspace<T, C, N>& s, const T* direct,
                      const Sensitivity& from, const Sensitivity& to) {
  using P = Pack<T>;
  constexpr int kWidth = math::kPackWidth<T>;
  const StepProgram& program = *c.program;
  const int n = s.Joints(program.tree), states = kStates >= 0 ? kStates : program.max_states;
  const bool coupling = c.packs->num_uncoupled < c.packs->count;
  const auto& g = s.gradients;
  const MatrixColumns<T, C, N> B_q(s.B_q), B_v(s.B_v), inverse(s.inverse);
  for (int column = 0; column < directions.columns; ++column) {
    const ColumnRows<T, C> x = ColumnOf<T, C>(program, from, column), y = ColumnOf<T, C>(program, to, column);
    const T* own = column < directions.first_direct ? nullptr : direct + column * C;
    alignas(64) T u[C], v1[C];
    if (states > 0) {
      for (int r = 0; r < n; r += kWidth) {
        P sum = own == nullptr ? P(0.0) : math::LoadPack(own + r);
        for (int k = 0; k < states; ++k) {
          sum += math::LoadPack(g.force_by_state[k] + r) * math::LoadPack(x.z(k) + r);
        }
        math::StorePack(u + r, sum);
      }
      for (int i = 0; i < n && coupling; ++i) {
        const int source = program.joints[i].coupled_to;
        if (source < 0) continue;
        for (int k = 0; k < program.joints[source].num_states; ++k) {
          u[i] += g.force[kCoupled][i] * g.drive[kFirstState + k][source] * x.z(k)[source];
        }
      }
      own = u;
    }
    for (int r = 0; r < n; r += kWidth) {
      P sum = B_q.Times(n, x.q(), r) + B_v.Times(n, x.v(), r);
      if (own != nullptr) sum += inverse.Times(n, own, r);
      math::StorePack(v1 + r, sum);
    }
    for (int r = 0; r < n; r += kWidth) {
      const P q = math::LoadPack(x.q() + r), v = math::LoadPack(x.v() + r), end = math::LoadPack(v1 + r);
      P z[kStates >= 0 ? kStates + 1 : kMaxStates];
      for (int k = 0; k < states; ++k) z[k] = math::LoadPack(x.z(k) + r);
      for (int k = 0; k < states; ++k) {
        P sum = z[k] * math::LoadPack(g.state_by_state[k][k] + r);
        if (!g.alone[k]) {
          sum += end * math::LoadPack(g.state[k][kEndVelocity] + r) +
                 v * math::LoadPack(g.state[k][kVelocity] + r) +
                 q * math::LoadPack(g.state[k][kPosition] + r);
          for (int m = 0; m < states; ++m) {
            if (m != k) sum += z[m] * math::LoadPack(g.state_by_state[k][m] + r);
          }
        }
        math::StorePack(y.z(k) + r, sum);
      }
      math::StorePack(y.v() + r, end);
      math::StorePack(y.q() + r, q + v * P(position_begin) + end * P(position_end));
    }
  }
}

// Solves for dv1 and moves all columns to the step's end. q1 = q0 + position_begin·v0 + position_end·v1.
// `to` may be `from`.
template <class T, int C, int N>
void Propagate(const LawContext<T, C>& c, const Directions& directions, T position_begin, T position_end,
               const StepWorkspace<T, C, N>& s, const T* direct, const Sensitivity& from,
               const Sensitivity& to) {
  const StepProgram& program = *c.program;
  const auto columns = [&]<int kStates>() {
    PropagateColumns<kStates>(c, directions, position_begin, position_end, s, direct, from, to);
  };
  switch (program.max_states) {
    case 0:
      return columns.template operator()<0>();
    case 1:
      columns.template operator()<1>();
      break;
    case 2:
      columns.template operator()<2>();
      break;
    case 3:
      columns.template operator()<3>();
      break;
    default:
      columns.template operator()<-1>();
  }
  const auto& g = s.gradients;
  const auto add = [&](int joint, int local, int column, T weight) RG_LAMBDA_INLINE {
    const ColumnRows<T, C> y = ColumnOf<T, C>(program, to, column);
    for (int k = 0; k < program.joints[joint].num_states; ++k) {
      y.z(k)[joint] += weight * g.state[k][local][joint];
    }
  };
  for (int k = 0; k < directions.num_locals; ++k) {
    const auto& l = directions.locals[k];
    add(l.joint, l.local, l.column, T(1.0));
  }
  for (int k = 0; k < directions.num_commands; ++k) {
    const auto& l = directions.commands[k];
    add(l.joint, kCommand, l.column, c.input->command_weights[k]);
  }
}

// All of it, after SetAcceleration at the solution s.v1.
template <class T, int C, int N>
RG_INLINE void Sensitivities(const LawContext<T, C>& c, const Directions& directions,
                             const StepWeights<T>& weights, T position_begin, T position_end,
                             StepWorkspace<T, C, N>& s, double* direct, const Sensitivity& from,
                             const Sensitivity& to) {
  const dynamics::Tree& tree = c.program->tree;
  dynamics::Derivatives(tree, s.w);
  dynamics::Regressor(tree, s.w);
  Gradients(c, directions, s.v1, &s.gradients);
  ForEachDrive<T>(*c.program, *c.values, [&](const DriveRow<T>& r) RG_LAMBDA_INLINE {
    const auto& by = s.gradients.force;
    s.by_ratio[r.law - tree.n] = by[kEndVelocity][r.law] * s.v1[r.other] +
                                 by[kVelocity][r.law] * c.input->v[r.other] +
                                 by[kPosition][r.law] * c.input->q[r.other];
  });
  DirectForces(c, directions, s, reinterpret_cast<T*>(direct));
  s.failure.Add(StateMatrices(c, weights, s), StepStatus::kMassMatrixNotPositive, 0);
  if (s.failure.all()) return;
  TimesInverse<T, C>(s.Joints(tree), s.inverse, s.B_q);
  TimesInverse<T, C>(s.Joints(tree), s.inverse, s.B_v);
  Propagate(c, directions, position_begin, position_end, s, reinterpret_cast<const T*>(direct), from, to);
}

// The state at the step's end; `position` of a joint. Lanes that failed keep what they had.
template <class T, int C, int N, class Position>
RG_INLINE void Store(const StepProgram& program, const StepOutput& output, const StepWorkspace<T, C, N>& s,
                     Position position) {
  const auto at = [](double* p) { return reinterpret_cast<T*>(p); };
  for (int i = 0; i < s.Joints(program.tree); ++i) {
    at(output.v)[i] = s.v1[i];
    at(output.q)[i] = position(i);
  }
  for (int i = 0; i < program.num_states; ++i) at(output.z)[i] = s.z1[i];
}

}  // namespace RG_ISA
}  // namespace rg::integrators
