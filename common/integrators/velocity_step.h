// The implicit velocity step: find v1 with
//
//   M·(v1 − v0)/h + bias = F(v1),   F_i a scalar law of v1_i alone, falling with it (effects/joint_law.h),
//                                   and R f(Rᵀ v1) of drives that turn with two joints (coupled_drives.h)
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
template <class T, int C>
RG_INLINE T TermSize(const LawContext<T, C>& c, int i, T bias, T force, T slope, T v1) {
  const T speed = math::Abs(c.input->v[i]) + math::Abs(v1);
  return math::Abs(bias) + math::Abs(force) + math::Abs(slope) * speed;
}
template <class T, int C>
RG_INLINE T Rounding(const LawContext<T, C>& c, int i, T slope) {
  return T(4e-15) * math::Abs(slope) * math::Abs(c.input->q[i]) * c.input->inverse_h + T(1e-300);
}

// The same of what coupled drives add to joint i's equation.
template <class T, int C>
RG_INLINE T DriveTermSize(const LawContext<T, C>& c, int i, const T* force, const T* slope, const T* v1) {
  T size(0.0);
  ForEachDrive<T>(*c.program, *c.values, [&](const DriveRow<T>& r) RG_LAMBDA_INLINE {
    const T own = TermSize(c, r.law, T(0.0), force[r.law], slope[r.law], v1[r.law]);
    if (r.joint == i) size += own;
    if (r.other == i) size += math::Abs(r.ratio) * own;
  });
  return size;
}

// residual = M (v1 − v0)/h + bias − F, and whether it vanishes against the size of its terms.
template <class T, int C, int N>
RG_INLINE Mask<T> VelocityResidual(const LawContext<T, C>& c, const T* v1, const T* force, const T* slope,
                                   const StepWorkspace<T, C, N>& s, T* residual) {
  const int n = s.Joints(c.program->tree);
  const T* v0 = c.input->v;
  alignas(64) T inertial[C], size[C];
  const auto over_joints = [&](auto each) RG_LAMBDA_INLINE {
    for (int r = 0; r < n; r += math::kPackWidth<T>) each(r);
  };
  over_joints([&](int r) RG_LAMBDA_INLINE {
    Pack<T> sum(0.0), speed(0.0);
    for (int j = 0; j < n; ++j) {
      const Pack<T> m = s.w.M[j].Load(r);
      sum += m * Pack<T>((v1[j] - v0[j]) * c.input->inverse_h);
      speed += math::Abs(m) * Pack<T>((math::Abs(v0[j]) + math::Abs(v1[j])) * c.input->inverse_h);
    }
    math::StorePack(inertial + r, sum);
    math::StorePack(size + r, speed);
  });
  Mask<T> small = true;
  for (int i = 0; i < n; ++i) {
    residual[i] = inertial[i] + s.bias[i] - force[i];
    const T terms =
        TermSize(c, i, s.bias[i], force[i], slope[i], v1[i]) + DriveTermSize(c, i, force, slope, v1);
    if (c.program->joints[i].prescribed) continue;
    small = And(small,
                math::Abs(residual[i]) <= T(1e-12) * terms + T(4e-16) * size[i] + Rounding(c, i, slope[i]));
  }
  DropBoundRows(*c.program, residual);
  return small;
}

// Whether the slopes did not change over a full Newton step, so that it was exact and what is left of the
// residual is rounding. A jump of the forces between two regions of equal slope leaves more.
template <class T, int C, int N>
RG_INLINE Mask<T> Affine(const LawContext<T, C>& c, const T* v1, const StepWorkspace<T, C, N>& s,
                         const T* step, const T* residual) {
  Mask<T> affine = true;
  for (int i = 0; i < s.Joints(c.program->tree); ++i) {
    const T size = TermSize(c, i, s.bias[i], s.trial_force[i], s.trial_slope[i], v1[i]) +
                   DriveTermSize(c, i, s.trial_force, s.trial_slope, v1);
    affine = And(affine, math::Abs((s.trial_slope[i] - s.slope[i]) * step[i]) <= T(1e-12) * size + T(1e-300));
    affine = And(affine, math::Abs(residual[i]) <= T(1e-8) * size + T(1e-300));
  }
  ForEachDrive<T>(*c.program, *c.values, [&](const DriveRow<T>& r) RG_LAMBDA_INLINE {
    const T size = TermSize(c, r.law, T(0.0), s.trial_force[r.law], s.trial_slope[r.law], v1[r.law]);
    const T turned = (s.trial_slope[r.law] - s.slope[r.law]) * r.Of(step);
    affine = And(affine, math::Abs(turned) <= T(1e-12) * size + T(1e-300));
  });
  return affine;
}

// The zero along a Newton step of the convex function's slope: all of the step unless a kink lies before.
// One search per lane; a lane that has found its point keeps it while others go on.
template <class T>
struct LineSearch {
  T low = T(0.0), high = T(1.0), at = T(1.0), low_slope, high_slope = T(0.0);
  T downhill;  // < 0
  Mask<T> searching;

  LineSearch(T d, Mask<T> active) : low_slope(d), downhill(d), searching(active) {}

  // `finished`: the trial at `at` is the solution; `slope`: there. Moves on where that does not end it.
  RG_INLINE void Next(int search, Mask<T> finished, T slope) {
    const Mask<T> before = Not(slope > T(-0.1) * downhill);
    const Mask<T> good = And(before, Or(at >= T(1.0), slope > T(0.1) * downhill));
    searching = And(searching, Not(Or(finished, good)));
    if (!Any(searching)) return;
    low = Select(before, at, low);
    low_slope = Select(before, slope, low_slope);
    high = Select(before, high, at);
    high_slope = Select(before, high_slope, slope);
    const T width = high - low;
    const T secant = low - low_slope * width / (high_slope - low_slope);
    const Mask<T> inside = And(secant > low + T(0.01) * width, secant < high - T(0.01) * width);
    const T middle = T(0.5) * (low + high);
    at = search % 3 == 2 ? middle : Select(inside, secant, middle);
    searching = And(searching, Not(width < T(1e-15)));
  }
};

// Solves for s.v1 from its present value, which holds what is given (SetGivenVelocities), in the lanes that
// are not in `settled`; w.M and s.bias must be set.
// Afterwards s.v1, s.force, s.slope (of all laws) and s.z1 are those of the solution. `known`: s.force and
// s.slope are already those at s.v1.
template <class T, int C, int N>
void SolveVelocity(const LawContext<T, C>& c, bool known, Mask<T> settled, StepWorkspace<T, C, N>& s) {
  const StepProgram& program = *c.program;
  const StepValues& values = *c.values;
  const int n = s.Joints(program.tree), laws = n + program.num_drives;
  T residual[C] = {}, step[C] = {};
  if (!known) SetDrives(program, values, s.v1);
  if (!known) FreeForces(c, s.v1, s.force, s.slope, s.z1);
  Mask<T> done = Or(Or(settled, s.failure.failed), VelocityResidual(c, s.v1, s.force, s.slope, s, residual));
  for (int iteration = 0; iteration < kMaxNewton && !All(done); ++iteration) {
    // The slopes often are those of the last factor: of this step's first pass, or before an exact step.
    Mask<T> same = s.factored;
    for (int i = 0; i < n; ++i) {
      same = And(same, And(s.slope[i] <= s.factored_slope[i], s.slope[i] >= s.factored_slope[i]));
      step[i] = -residual[i];
    }
    for (int k = n; k < laws; ++k) {
      same = And(same, And(s.slope[k] <= s.factored_slope[k], s.slope[k] >= s.factored_slope[k]));
    }
    if (!All(Or(same, done))) {
      LoadMass(n, c.input->inverse_h, s, s.H);
      for (int i = 0; i < n; ++i) {
        s.H[i * C + i] -= s.slope[i];
        s.factored_slope[i] = s.slope[i];
      }
      ForEachDrive<T>(program, values, [&](const DriveRow<T>& r) RG_LAMBDA_INLINE {
        AddDriveSquare<T, C>(r, -s.slope[r.law], s.H);
        s.factored_slope[r.law] = s.slope[r.law];
      });
      SetApart<T, C>(program, s.H);
      s.factored = true;
      int row = -1;
      const Mask<T> bad = And(Cholesky<T, C>(n, s.H, s.diagonal, &row), Not(done));
      s.failure.Add(bad, StepStatus::kMassMatrixNotPositive, row);
      done = Or(done, bad);
      if (All(done)) return;
    }
    CholeskySolve<T, C>(n, s.H, s.diagonal, step);
    T downhill = T(0.0);
    for (int i = 0; i < n; ++i) downhill += residual[i] * step[i];
    LineSearch<T> line(downhill, Not(done));
    Mask<T> found = done;
    for (int i = 0; i < n; ++i) s.trial[i] = s.v1[i];
    for (int search = 0; search < kMaxLineSearch && Any(line.searching); ++search) {
      Mask<T> still = true;
      for (int i = 0; i < n; ++i) {
        s.trial[i] = Select(line.searching, s.v1[i] + line.at * step[i], s.trial[i]);
        still = And(still, And(s.trial[i] <= s.v1[i], s.trial[i] >= s.v1[i]));
      }
      FollowDrivers(program, s.trial);
      SetDrives(program, values, s.trial);
      FreeForces(c, s.trial, s.trial_force, s.trial_slope, s.z1);
      Mask<T> finished = VelocityResidual(c, s.trial, s.trial_force, s.trial_slope, s, residual);
      finished = Or(finished, still);
      if (!All(Or(finished, Not(line.searching)))) {
        finished = Or(finished, And(line.at >= T(1.0), Affine(c, s.trial, s, step, residual)));
      }
      found = Or(found, And(line.searching, finished));
      T slope = T(0.0);
      for (int i = 0; i < n; ++i) slope += residual[i] * step[i];
      line.Next(search, finished, slope);
    }
    for (int i = 0; i < n; ++i) {
      s.v1[i] = s.trial[i];
      s.force[i] = s.trial_force[i];
      s.slope[i] = s.trial_slope[i];
      s.failure.Add(Not(Or(done, math::Abs(s.v1[i]) < T(1e300))), StepStatus::kNonFinite, i);
    }
    for (int k = n; k < laws; ++k) {
      s.v1[k] = s.trial[k];
      s.force[k] = s.trial_force[k];
      s.slope[k] = s.trial_slope[k];
    }
    done = Or(found, s.failure.failed);
  }
  s.failure.Add(Not(done), StepStatus::kNotConverged, 0);
}

}  // namespace RG_ISA
}  // namespace rg::integrators
