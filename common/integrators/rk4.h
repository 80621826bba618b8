// Classical Runge-Kutta of fourth order, explicit: for smooth plants without internal states, whose
// damping the step resolves (h·d/M well below 2.7). Sign functions are smoothed (StepValues::rk4_sign_width).
//
//   k_s = (v_s, a(q_s, v_s)),  s = 1…4 at 0, h/2, h/2, h;   x⁺ = x + h/6·(k_1 + 2 k_2 + 2 k_3 + k_4)
#pragma once

#include "common/integrators/step_sensitivity.h"

namespace rg::integrators {
inline namespace RG_ISA {

// s.v1 = acceleration at c.input's (q, v) under the laws' instantaneous forces; leaves w ready for
// Derivatives.
template <int C, int N>
void Acceleration(const LawContext<double, C>& c, bool derivatives, StepWorkspace<double, C, N>& s) {
  const dynamics::Tree& tree = c.program->tree;
  const int n = s.Joints(tree);
  const StepState<double, C>& at = *c.input;
  s.failure = {};
  dynamics::CopyIn(n, at.q, s.w.q);
  dynamics::Kinematics(tree, s.w);
  BiasHere(tree, at.v, s);
  MassMatrixHere(*c.program, s);
  PointForces(*c.program, *c.values, at.v, at.t, at.t, derivatives, s);
  SetBias(*c.program, s);
  FreeForces(c, at.v, s.force, s.slope, s.z1);
  LoadMass(n, 1.0, s, s.H);
  for (int i = 0; i < n; ++i) {
    s.H[i * C + i] += s.armature[i];
    s.v1[i] = s.force[i] - s.bias[i];
  }
  ForEachDrive<double>(*c.program, *c.values, [&](const DriveRow<double>& r) {
    AddDriveSquare<double, C>(r, s.armature[r.law], s.H);
  });
  SetApart<double, C>(*c.program, s.H);
  DropBoundRows(*c.program, s.v1);
  int row = -1;
  s.failure.Add(Cholesky<double, C>(n, s.H, s.diagonal, &row), StepStatus::kMassMatrixNotPositive, row);
  if (s.failure.all()) return;
  CholeskySolve<double, C>(n, s.H, s.diagonal, s.v1);
  FollowDrivers(*c.program, s.v1);
  SetDrives(*c.program, *c.values, s.v1);
  for (int i = 0; i < n; ++i) s.failure.Add(!(math::Abs(s.v1[i]) < 1e300), StepStatus::kNonFinite, i);
}

// da = H⁻¹(B_q dq + B_v dv + direct) of one stage; dq, dv, da: [column][C].
template <int C, int N>
void StageSensitivity(const LawContext<double, C>& c, const Directions& directions,
                      StepWorkspace<double, C, N>& s, double* direct, const double* dq, const double* dv,
                      double* da) {
  const StepProgram& program = *c.program;
  const int n = s.Joints(program.tree);
  dynamics::SetAcceleration(program.tree, s.v1, s.w);
  dynamics::Derivatives(program.tree, s.w);
  dynamics::Regressor(program.tree, s.w);
  Gradients(c, directions, c.input->v, &s.gradients);
  auto& force = s.gradients.force;
  // The laws saw no acceleration: a rotor inertia's own derivative is −a.
  for (int i = 0; i < program.num_laws(); ++i) {
    const JointProgram& joint = program.joints[i];
    for (int k = joint.first_op; k < joint.first_op + joint.num_ops; ++k) {
      effects::WithEffectType(program.ops[k].kind, [&]<class E>() {
        if constexpr (requires { E::kInertiaParameter; }) {
          const int local = kFirstState + joint.num_states + program.ops[k].parameter + E::kInertiaParameter;
          force[local][i] -= s.v1[i];
        }
      });
    }
  }
  ForEachDrive<double>(program, *c.values, [&](const DriveRow<double>& r) {
    s.force[r.law] -= s.armature[r.law] * s.v1[r.law];
    s.by_ratio[r.law - program.tree.n] =
        (force[kEndVelocity][r.law] + force[kVelocity][r.law]) * c.input->v[r.other] +
        force[kPosition][r.law] * c.input->q[r.other] - s.armature[r.law] * s.v1[r.other];
  });
  DirectForces(c, directions, s, direct);
  for (int i = 0; i < n; ++i) {
    for (int j = 0; j < n; ++j) {
      s.inverse[j][i] = s.w.M[j][i];
      s.B_q[j][i] = -s.w.dtau_dq[j][i];
      s.B_v[j][i] = -s.w.dtau_dv[j][i];
      if (program.num_point_forces > 0) {
        s.B_q[j][i] += s.E_q[i * C + j];
        s.B_v[j][i] += s.E_v[i * C + j];
      }
    }
    s.inverse[i][i] += s.armature[i];
    s.B_q[i][i] += force[kPosition][i];
    s.B_v[i][i] += force[kVelocity][i] + force[kEndVelocity][i];
    if (const int other = program.joints[i].sees; other >= 0) s.B_q[other][i] += force[kCoupled][i];
    if (const int source = program.joints[i].coupled_to; source >= 0) {
      const auto& drive = s.gradients.drive;
      s.B_q[source][i] += force[kCoupled][i] * drive[kPosition][source];
      s.B_v[source][i] += force[kCoupled][i] * (drive[kVelocity][source] + drive[kEndVelocity][source]);
    }
  }
  ForEachDrive<double>(program, *c.values, [&](const DriveRow<double>& r) {
    AddDriveSquare<double, C>(r, s.armature[r.law], s.inverse);
    AddDriveSquare<double, C>(r, force[kPosition][r.law], s.B_q);
    AddDriveSquare<double, C>(r, force[kVelocity][r.law] + force[kEndVelocity][r.law], s.B_v);
  });
  BindStateMatrices(program, s);
  s.failure.Add(Invert<double, C>(n, s.inverse), StepStatus::kMassMatrixNotPositive, 0);
  for (int column = 0; column < directions.columns; ++column) {
    math::Row<double, C> rhs, end;
    const double *own = direct + column * C, *q = dq + column * C, *v = dv + column * C;
    for (int i = 0; i < n; ++i) {
      rhs[i] = own[i];
      for (int j = 0; j < n; ++j) rhs[i] += s.B_q[j][i] * q[j] + s.B_v[j][i] * v[j];
    }
    math::MatrixTimes<double, C>(n, s.inverse, rhs, end);
    for (int i = 0; i < n; ++i) da[column * C + i] = end[i];
  }
}

// `direct`: columns × C, followed by three times as much scratch when directions are given.
template <int C, int N>
StepResult Rk4Step(const StepProgram& program, const StepValues& values, const StepInput& input,
                   const Directions* directions, double* direct, const Sensitivity& from,
                   const Sensitivity& to, const StepOutput& output, StepWorkspace<double, C, N>& s) {
  const int n = s.Joints(program.tree);
  s.input.Load(program, values, input, n);
  const StepState<double, C> start = s.input;
  const double h = start.h;
  constexpr double kNode[4] = {0.0, 0.5, 0.5, 1.0};
  constexpr double kShare[4] = {1.0 / 6, 1.0 / 3, 1.0 / 3, 1.0 / 6};
  double previous_v[C], previous_a[C] = {}, sum_v[C] = {}, sum_a[C] = {};
  for (int i = 0; i < n; ++i) previous_v[i] = start.v[i];
  const int columns = directions == nullptr ? 0 : directions->columns;
  double *dq = direct + columns * C, *dv = dq + columns * C, *da = dv + columns * C;
  const auto each = [&](auto f) {
    for (int column = 0; column < columns; ++column) {
      const auto x = ColumnOf<double, C>(program, from, column), y = ColumnOf<double, C>(program, to, column);
      for (int i = 0; i < n; ++i) f(column * C + i, x.q()[i], x.v()[i], y.q()[i], y.v()[i]);
    }
  };
  each([&](int k, double q, double v, double& to_q, double& to_v) {
    to_q = q, to_v = dv[k] = v, da[k] = 0.0;
  });
  for (int stage = 0; stage < 4; ++stage) {
    const double shift = kNode[stage] * h;
    for (int i = 0; i < n; ++i) {
      s.input.q[i] = start.q[i] + shift * previous_v[i];
      s.input.v[i] = start.v[i] + shift * previous_a[i];
    }
    s.input.SetDrives(program, values);
    s.input.t = start.t + shift;
    const LawContext<double, C> c{&program, &values, &s.input, {false, true}, s.mass, &s.laws};
    Acceleration(c, directions != nullptr, s);
    if (s.failure.all()) return s.failure.Result();
    for (int i = 0; i < n; ++i) {
      sum_v[i] += kShare[stage] * s.input.v[i];
      sum_a[i] += kShare[stage] * s.v1[i];
      previous_v[i] = s.input.v[i];
      previous_a[i] = s.v1[i];
    }
    if (directions == nullptr) continue;
    each([&](int k, double q, double v, double&, double&) {
      dq[k] = q + shift * dv[k];
      dv[k] = v + shift * da[k];
    });
    StageSensitivity(c, *directions, s, direct, dq, dv, da);
    if (s.failure.all()) return s.failure.Result();
    each([&](int k, double, double, double& to_q, double& to_v) {
      to_q += h * kShare[stage] * dv[k];
      to_v += h * kShare[stage] * da[k];
    });
  }
  for (int i = 0; i < n; ++i) {
    output.q[i] = start.q[i] + h * sum_v[i];
    output.v[i] = start.v[i] + h * sum_a[i];
  }
  return {};
}

}  // namespace RG_ISA
}  // namespace rg::integrators
