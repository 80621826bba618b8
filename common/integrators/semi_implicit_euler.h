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

template <int C>
StepResult SemiImplicitEulerStep(const StepProgram& program, const StepValues& values, const StepInput& input,
                                 const Directions* directions, double* direct, const Sensitivity& from,
                                 const Sensitivity& to, const StepOutput& output, StepWorkspace<C>& s) {
  const dynamics::Tree& tree = program.tree;
  const int n = tree.n;
  const double h = input.h;
  const LawContext c{&program, &values, &input, {true, false}, s.mass, s.rough};

  dynamics::CopyIn(n, input.q, s.w.q);
  dynamics::Kinematics(tree, s.w);
  BiasHere(tree, values.gravity, input.v, s);
  dynamics::CompositeForces(tree, s.w);
  dynamics::MassMatrix(tree, s.w);
  const int bad = UpdateEffectiveInertias(n, input.v, values.stick_velocity, s);
  if (bad >= 0) return {StepStatus::kMassMatrixNotPositive, bad};
  PointForces(program, values, input.v, input.t, input.t + h, directions != nullptr, s);
  for (int i = 0; i < n; ++i) {
    s.bias[i] = s.w.c[i] - s.E[i];
    s.v1[i] = input.v[i];
  }
  const StepResult result = SolveVelocity(c, false, s);
  if (result.status != StepStatus::kOk) return result;

  if (directions != nullptr) {
    double a[C];
    for (int i = 0; i < n; ++i) a[i] = (s.v1[i] - input.v[i]) / h;
    dynamics::SetAcceleration(tree, a, s.w);
    dynamics::Derivatives(tree, s.w);
    dynamics::Regressor(tree, s.w);
    Gradients(c, *directions, s.v1, &s.gradients);
    DirectForces(c, *directions, s, direct);
    if (!StateMatrices(c, {0.0, 1.0, 0.0}, s)) return {StepStatus::kMassMatrixNotPositive, 0};
    Propagate(c, *directions, 0.0, h, s, direct, from, to);
  }
  for (int i = 0; i < n; ++i) {
    output.v[i] = s.v1[i];
    output.q[i] = input.q[i] + h * s.v1[i];
  }
  for (int i = 0; i < program.num_states; ++i) output.z[i] = s.z1[i];
  return {};
}

}  // namespace RG_ISA
}  // namespace rg::integrators
