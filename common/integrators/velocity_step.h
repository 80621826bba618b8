// The implicit velocity step: find v1 with
//
//   M·(v1 − v0)/h + bias = F(v1),   F_i a scalar law of v1_i alone, falling with it (effects/joint_law.h)
//
// This is the stationarity of a strictly convex function of v1 (M positive definite, F monotone), so
// Newton's method with an exact line search converges from anywhere; away from reversals it takes one
// iteration. Sticking is a steep ramp of F at v1 = 0, which Newton's piecewise linear steps land on.
#pragma once

#include "common/integrators/step_workspace.h"

namespace rg::integrators {
inline namespace RG_ISA {

inline constexpr int kMaxNewton = 60;
inline constexpr int kMaxLineSearch = 60;

// How large the terms of joint i's equation are, and how far rounding in its law may reach: laws take
// differences of positions times stiffness, with slope·(q/h) as the size of what is subtracted.
RG_INLINE double TermSize(const LawContext& c, int i, double bias, double force, double slope, double v1) {
  const double speed = __builtin_fabs(c.input->v[i]) + __builtin_fabs(v1);
  return __builtin_fabs(bias) + __builtin_fabs(force) + __builtin_fabs(slope) * speed;
}
RG_INLINE double Rounding(const LawContext& c, int i, double slope) {
  return 4e-15 * __builtin_fabs(slope) * __builtin_fabs(c.input->q[i]) / c.input->h + 1e-300;
}

// residual = M (v1 − v0)/h + bias − F, and whether it vanishes against the size of its terms.
template <int C>
RG_INLINE bool VelocityResidual(const LawContext& c, const double* v1, const double* force,
                                const double* slope, const StepWorkspace<C>& s, double* residual) {
  const int n = c.program->tree.n;
  const double inverse_h = 1.0 / c.input->h;
  const double* v0 = c.input->v;
  bool small = true;
  for (int i = 0; i < n; ++i) {
    double inertial = 0.0, speed = 0.0;
    for (int j = 0; j < n; ++j) {
      const double m = s.w.M[j][i] * inverse_h;
      inertial += m * (v1[j] - v0[j]);
      speed += __builtin_fabs(m) * (__builtin_fabs(v0[j]) + __builtin_fabs(v1[j]));
    }
    residual[i] = inertial + s.bias[i] - force[i];
    const double size = TermSize(c, i, s.bias[i], force[i], slope[i], v1[i]);
    small &= __builtin_fabs(residual[i]) <= 1e-12 * size + 4e-16 * speed + Rounding(c, i, slope[i]);
  }
  return small;
}

// Whether the slopes did not change over a full Newton step, so that it was exact and what is left of the
// residual is rounding. A jump of the forces between two regions of equal slope leaves more.
template <int C>
RG_INLINE bool Affine(const LawContext& c, const double* v1, const StepWorkspace<C>& s, const double* step,
                      const double* residual) {
  bool affine = true;
  for (int i = 0; i < c.program->tree.n; ++i) {
    const double size = TermSize(c, i, s.bias[i], s.trial_force[i], s.trial_slope[i], v1[i]);
    affine &= __builtin_fabs((s.trial_slope[i] - s.slope[i]) * step[i]) <= 1e-12 * size + 1e-300;
    affine &= __builtin_fabs(residual[i]) <= 1e-8 * size + 1e-300;
  }
  return affine;
}

// On entry s.v1 is the first guess; on success s.v1, s.force, s.slope and s.z1 are those of the solution.
// `known`: s.force and s.slope are already those at s.v1.
template <int C>
StepResult SolveVelocity(const LawContext& c, bool known, StepWorkspace<C>& s) {
  const int n = c.program->tree.n;
  const double inverse_h = 1.0 / c.input->h;
  double residual[C], step[C], trial[C];
  if (!known) Forces(c, s.v1, s.force, s.slope, s.z1);
  if (VelocityResidual(c, s.v1, s.force, s.slope, s, residual)) return {};
  for (int iteration = 0; iteration < kMaxNewton; ++iteration) {
    LoadMass(n, inverse_h, s, s.H);
    for (int i = 0; i < n; ++i) {
      s.H[i * C + i] -= s.slope[i];
      step[i] = -residual[i];
    }
    const int bad = Cholesky<C>(n, s.H, s.diagonal);
    if (bad >= 0) return {StepStatus::kMassMatrixNotPositive, bad};
    CholeskySolve<C>(n, s.H, s.diagonal, step);
    double downhill = 0.0;  // slope of the convex function along the step, < 0
    for (int i = 0; i < n; ++i) downhill += residual[i] * step[i];
    // The zero of the slope along the step: all of it unless a kink lies before.
    double low = 0.0, high = 1.0, at = 1.0, low_slope = downhill, high_slope = 0.0;
    bool done = false;
    for (int search = 0; search < kMaxLineSearch; ++search) {
      bool moved = false;
      for (int i = 0; i < n; ++i) {
        trial[i] = s.v1[i] + at * step[i];
        moved |= trial[i] != s.v1[i];
      }
      Forces(c, trial, s.trial_force, s.trial_slope, s.z1);
      done = VelocityResidual(c, trial, s.trial_force, s.trial_slope, s, residual);
      done = done || !moved || (at == 1.0 && Affine(c, trial, s, step, residual));
      if (done) break;
      double slope = 0.0;
      for (int i = 0; i < n; ++i) slope += residual[i] * step[i];
      if (!(slope > 0.1 * -downhill)) {
        if (at == 1.0 || slope > 0.1 * downhill) break;
        low = at;
        low_slope = slope;
      } else {
        high = at;
        high_slope = slope;
      }
      const double secant = low - low_slope * (high - low) / (high_slope - low_slope);
      const double width = high - low;
      const bool inside = secant > low + 0.01 * width && secant < high - 0.01 * width;
      at = search % 3 != 2 && inside ? secant : 0.5 * (low + high);
      if (width < 1e-15) break;
    }
    for (int i = 0; i < n; ++i) {
      s.v1[i] = trial[i];
      s.force[i] = s.trial_force[i];
      s.slope[i] = s.trial_slope[i];
      if (!(__builtin_fabs(trial[i]) < 1e300)) return {StepStatus::kNonFinite, i};
    }
    if (done) return {};
  }
  return {StepStatus::kNotConverged, 0};
}

}  // namespace RG_ISA
}  // namespace rg::integrators
