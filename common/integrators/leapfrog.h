// Drift, implicit kick, drift: second order, one mass matrix per step.
//
//   q½ = q + h/2·v
//   M(q½)·(v⁺ − v)/h + c(q½, (v + v⁺)/2) = F(v⁺) + point forces      v⁺ implicit in the joint forces F
//   q⁺ = q½ + h/2·v⁺
//
// The bias c is taken at the mean velocity by a fixed point: at v for a first v⁺, then at (v + v⁺)/2, and
// again while that still matters (each pass gains a factor h/2·|M⁻¹ dc/dv|; at an arm's usual speeds two
// do). Where passes do not shrink, the motion is too fast for the step and the outcome says so. Joint
// forces that the step resolves are taken at its middle (effects/joint_law.h): the whole is second order.
#pragma once

#include "common/integrators/step_sensitivity.h"
#include "common/integrators/velocity_step.h"

namespace rg::integrators {
inline namespace RG_ISA {

inline constexpr int kMaxPasses = 25;
inline constexpr double kPassTolerance = 1e-6;  // of velocity, per second

template <class T, int C, int N>
StepResult LeapfrogStep(const StepProgram& program, const StepValues& values, const StepInput& input,
                        const Directions* directions, double* direct, const Sensitivity& from,
                        const Sensitivity& to, const StepOutput& output, StepWorkspace<T, C, N>& s) {
  const dynamics::Tree& tree = program.tree;
  const int n = s.Joints(tree);
  s.input.Load(program, values, input, n);
  s.failure = {};
  const T h = s.input.h, begin = s.input.t, end = begin + h;
  const T *q0 = s.input.q, *v0 = s.input.v;
  const LawContext<T, C> c{&program, &values, &s.input, {false, false}, s.mass, &s.laws};

  for (int i = 0; i < n; ++i) s.half[i] = q0[i] + T(0.5) * h * v0[i];
  dynamics::CopyIn(n, s.half, s.w.q);
  dynamics::Kinematics(tree, s.w);

  // First pass: everything at v.
  BiasHere(tree, v0, s);
  MassMatrixHere(program, s);
  UpdateEffectiveInertias(program, values, v0, s);
  PointForces(program, values, v0, begin, end, false, s);
  SetBias(program, s);
  for (int i = 0; i < n; ++i) s.v1[i] = v0[i];
  SetGivenVelocities(program, s.input.command, s.v1);
  SolveVelocity(c, false, s.failure.failed, s);

  // Further passes: the bias at the mean velocity, until what one more would change is negligible.
  T change = T(0.0), size = T(1.0);
  for (int i = 0; i < n; ++i) change = math::Max(change, T(0.5) * math::Abs(s.v1[i] - v0[i]));
  for (int i = 0; i < n; ++i) s.mean[i] = v0[i];
  Mask<T> settled = s.failure.failed;
  for (int pass = 0; !All(settled); ++pass) {
    if (pass == kMaxPasses) {
      s.failure.Add(Not(settled), StepStatus::kNotConverged, 0);
      break;
    }
    for (int i = 0; i < n; ++i) s.mean[i] = Select(settled, s.mean[i], T(0.5) * (v0[i] + s.v1[i]));
    BiasHere(tree, s.mean, s);
    PointForces(program, values, s.mean, begin, end, directions != nullptr, s);
    SetBias(program, s);
    for (int i = 0; i < n; ++i) s.before[i] = s.v1[i];
    SolveVelocity(c, true, settled, s);
    const T last = change;
    change = T(0.0);
    for (int i = 0; i < n; ++i) {
      change = math::Max(change, T(0.5) * math::Abs(s.v1[i] - s.before[i]));
      size = math::Max(size, math::Abs(s.v1[i]));
    }
    // What the next would change, if they shrink evenly.
    settled = Or(Or(settled, s.failure.failed), change * change <= T(kPassTolerance) * h * size * last);
  }
  if (s.failure.all()) return s.failure.Result();

  if (directions != nullptr) {
    T a[C];
    for (int i = 0; i < n; ++i) a[i] = (s.v1[i] - v0[i]) * s.input.inverse_h;
    dynamics::SetAcceleration(tree, a, s.w);
    Sensitivities(c, *directions, {T(0.5) * h, 0.5, 0.5}, T(0.5) * h, T(0.5) * h, s, direct, from, to);
  }
  Store(program, output, s, [&](int i) RG_LAMBDA_INLINE { return s.half[i] + T(0.5) * h * s.v1[i]; });
  return s.failure.Result();
}

}  // namespace RG_ISA
}  // namespace rg::integrators
