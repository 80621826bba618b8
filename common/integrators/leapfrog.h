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

RG_INLINE double Larger(double a, double b) { return a > b ? a : b; }

template <int C>
StepResult LeapfrogStep(const StepProgram& program, const StepValues& values, const StepInput& input,
                        const Directions* directions, double* direct, const Sensitivity& from,
                        const Sensitivity& to, const StepOutput& output, StepWorkspace<C>& s) {
  const dynamics::Tree& tree = program.tree;
  const int n = tree.n;
  const double h = input.h, end = input.t + input.h;
  const LawContext c{&program, &values, &input, {false, false}, s.mass, s.rough};

  for (int i = 0; i < n; ++i) s.half[i] = input.q[i] + 0.5 * h * input.v[i];
  dynamics::CopyIn(n, s.half, s.w.q);
  dynamics::Kinematics(tree, s.w);

  // First pass: everything at v.
  BiasHere(tree, values.gravity, input.v, s);
  dynamics::CompositeForces(tree, s.w);
  dynamics::MassMatrix(tree, s.w);
  const int bad = UpdateEffectiveInertias(n, input.v, values.stick_velocity, s);
  if (bad >= 0) return {StepStatus::kMassMatrixNotPositive, bad};
  PointForces(program, values, input.v, input.t, end, false, s);
  for (int i = 0; i < n; ++i) {
    s.bias[i] = s.w.c[i] - s.E[i];
    s.v1[i] = input.v[i];
  }
  StepResult result = SolveVelocity(c, false, s);
  if (result.status != StepStatus::kOk) return result;

  // Further passes: the bias at the mean velocity, until what one more would change is negligible.
  double change = 0.0, size = 1.0;
  for (int i = 0; i < n; ++i) change = Larger(change, 0.5 * __builtin_fabs(s.v1[i] - input.v[i]));
  for (int pass = 0;; ++pass) {
    if (pass == kMaxPasses) return {StepStatus::kNotConverged, 0};
    for (int i = 0; i < n; ++i) s.mean[i] = 0.5 * (input.v[i] + s.v1[i]);
    BiasHere(tree, values.gravity, s.mean, s);
    PointForces(program, values, s.mean, input.t, end, directions != nullptr, s);
    for (int i = 0; i < n; ++i) {
      s.bias[i] = s.w.c[i] - s.E[i];
      s.before[i] = s.v1[i];
    }
    result = SolveVelocity(c, true, s);
    if (result.status != StepStatus::kOk) return result;
    const double last = change;
    change = 0.0;
    for (int i = 0; i < n; ++i) {
      change = Larger(change, 0.5 * __builtin_fabs(s.v1[i] - s.before[i]));
      size = Larger(size, __builtin_fabs(s.v1[i]));
    }
    if (change * change <= kPassTolerance * h * size * last) break;  // the next change, if they shrink evenly
  }

  if (directions != nullptr) {
    double a[C];
    for (int i = 0; i < n; ++i) a[i] = (s.v1[i] - input.v[i]) / h;
    dynamics::SetAcceleration(tree, a, s.w);
    dynamics::Derivatives(tree, s.w);
    dynamics::Regressor(tree, s.w);
    Gradients(c, *directions, s.v1, &s.gradients);
    DirectForces(c, *directions, s, direct);
    if (!StateMatrices(c, {0.5 * h, 0.5, 0.5}, s)) return {StepStatus::kMassMatrixNotPositive, 0};
    Propagate(c, *directions, 0.5 * h, 0.5 * h, s, direct, from, to);
  }
  for (int i = 0; i < n; ++i) {
    output.v[i] = s.v1[i];
    output.q[i] = s.half[i] + 0.5 * h * s.v1[i];
  }
  for (int i = 0; i < program.num_states; ++i) output.z[i] = s.z1[i];
  return {};
}

}  // namespace RG_ISA
}  // namespace rg::integrators
