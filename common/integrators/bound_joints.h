// Joints that are not free: prescribed ones, whose end velocity is given, and followers (dynamics::Tie),
// whose velocity is a multiple of their driver's.
//
// With q̇ = G ẏ, G constant, the equations of the free joints are Gᵀ(M G ÿ + c) = Gᵀ F: rows and columns of a
// follower are added to its driver's, ratio times each, and become zero. A prescribed joint's own equation is
// dropped; its motion stays in the others'. All functions do nothing where every joint is free.
#pragma once

#include "common/integrators/step_program.h"
#include "common/math/rows.h"

namespace rg::integrators {
inline namespace RG_ISA {

// x ← Gᵀ x, of generalised forces.
template <class T>
RG_INLINE void FoldForces(const StepProgram& program, T* x) {
  for (int i = 0; i < program.tree.num_ties; ++i) {
    const dynamics::Tie& tie = program.tree.ties[i];
    x[tie.driver] += T(tie.ratio) * x[tie.follower];
    x[tie.follower] = T(0.0);
  }
}

// The same of slopes dF_i/dv_i, ratio² of them.
template <class T>
RG_INLINE void FoldSlopes(const StepProgram& program, T* x) {
  for (int i = 0; i < program.tree.num_ties; ++i) {
    const dynamics::Tie& tie = program.tree.ties[i];
    x[tie.driver] += T(tie.ratio * tie.ratio) * x[tie.follower];
    x[tie.follower] = T(0.0);
  }
}

// A ← Gᵀ A G, A by columns.
template <class T, int C>
RG_INLINE void FoldMatrix(const StepProgram& program, int n, math::Row<T, C>* A) {
  for (int i = 0; i < program.tree.num_ties; ++i) {
    const dynamics::Tie& tie = program.tree.ties[i];
    const T ratio(tie.ratio), none(0.0);
    for (int r = 0; r < n; ++r) {
      A[tie.driver][r] += ratio * A[tie.follower][r];
      A[tie.follower][r] = none;
    }
    for (int c = 0; c < n; ++c) {
      A[c][tie.driver] += ratio * A[c][tie.follower];
      A[c][tie.follower] = none;
    }
  }
}

// Velocities v of followers from their drivers'.
template <class T>
RG_INLINE void FollowDrivers(const StepProgram& program, T* v) {
  for (int i = 0; i < program.tree.num_ties; ++i) {
    const dynamics::Tie& tie = program.tree.ties[i];
    v[tie.follower] = T(tie.ratio) * v[tie.driver];
  }
}

// End velocities that are given: of prescribed joints, and what follows.
template <class T>
RG_INLINE void SetGivenVelocities(const StepProgram& program, const T* command, T* v1) {
  if (program.all_free) return;
  for (int i = 0; i < program.tree.n; ++i) {
    if (program.joints[i].prescribed) v1[i] = command[i];
  }
  FollowDrivers(program, v1);
}

// Rows without an equation of their own, of folded x.
template <class T>
RG_INLINE void DropBoundRows(const StepProgram& program, T* x) {
  if (program.all_free) return;
  for (int i = 0; i < program.tree.n; ++i) {
    if (program.joints[i].prescribed) x[i] = T(0.0);
  }
}

// Makes the folded symmetric matrix H (row-major, leading dimension C) one of the free joints alone, the
// others apart with a one on their diagonal.
template <class T, int C>
RG_INLINE void SetApart(const StepProgram& program, T* H) {
  if (program.all_free) return;
  const int n = program.tree.n;
  const auto apart = [&](int i) RG_LAMBDA_INLINE {
    for (int k = 0; k < n; ++k) H[i * C + k] = H[k * C + i] = T(0.0);
    H[i * C + i] = T(1.0);
  };
  for (int i = 0; i < n; ++i) {
    if (program.joints[i].prescribed) apart(i);
  }
  for (int i = 0; i < program.tree.num_ties; ++i) apart(program.tree.ties[i].follower);
}

}  // namespace RG_ISA
}  // namespace rg::integrators
