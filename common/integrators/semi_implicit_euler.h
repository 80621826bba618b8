// The integrator of Collins et al.: velocity first, then position with the new velocity. First order.
//
//   M(q)·(v⁺ − v)/h + c(q, v) = F(v⁺),   q⁺ = q + h·v⁺
//
// with the joint forces F (damping, friction, elasticity) at the step's end, so that stiff ones hold.
#pragma once

#include "common/integrators/step_sensitivity.h"
#include "common/integrators/velocity_step.h"

namespace rg::integrators {
inline namespace RG_ISA {

template <class T, int C, int N>
StepResult SemiImplicitEulerStep(const StepProgram& program, const StepValues& values, const StepInput& input,
                                 const Directions* directions, double* direct, const Sensitivity& from,
                                 const Sensitivity& to, const StepOutput& output, StepWorkspace<T, C, N>& s) {
  const dynamics::Tree& tree = program.tree;
  const int n = s.Joints(tree);
  s.input.Load(program, values, input, n);
  s.failure = {};
  const T h = s.input.h;
  const T *q0 = s.input.q, *v0 = s.input.v;
  const LawContext<T, C> c{&program, &values, &s.input, {true, false}, s.mass, &s.laws};

  dynamics::CopyIn(n, q0, s.w.q);
  dynamics::Kinematics(tree, s.w);
  BiasHere(tree, v0, s);
  MassMatrixHere(program, s);
  UpdateEffectiveInertias(program, values, v0, s);
  PointForces(program, values, v0, s.input.t, s.input.t + h, directions != nullptr, s);
  SetBias(program, s);
  for (int i = 0; i < n; ++i) s.v1[i] = v0[i];
  SetGivenVelocities(program, s.input.command, s.v1);
  SolveVelocity(c, false, s.failure.failed, s);
  if (s.failure.all()) return s.failure.Result();

  if (directions != nullptr) {
    T a[C];
    for (int i = 0; i < n; ++i) a[i] = (s.v1[i] - v0[i]) * s.input.inverse_h;
    dynamics::SetAcceleration(tree, a, s.w);
    Sensitivities(c, *directions, {T(0.0), 1.0, 0.0}, T(0.0), h, s, direct, from, to);
  }
  Store(program, output, s, [&](int i) RG_LAMBDA_INLINE { return q0[i] + h * s.v1[i]; });
  return s.failure.Result();
}

}  // namespace RG_ISA
}  // namespace rg::integrators
