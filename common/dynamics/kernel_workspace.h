// Scratch and results of the kernels for one state (T = double) or several at once (T = Lanes<N>).
//
// Which stage writes what (kernels.h):
//   Kinematics      R p S                        from q
//   Velocities      V Sdot A0                    from v
//   BodyForces      sum (per body)               from V A0 and the inertias
//   Composites      sum (per subtree), F         sum of all bodies moved by the joint
//   Terms           M c
//   Derivatives     A Sddot, dtau_dq dtau_dv     from an acceleration a
//   Regressor       Y                            from A
//
// Matrices are column-major with leading dimension Capacity: column j of M is M[j], n rows; rows past
// the last joint are zero or meaningless but finite. All vectors are in axes of W about W's origin.
#pragma once

#include "common/math/rows.h"

namespace rg::dynamics {
inline namespace RG_ISA {

using math::Pack;
using math::Row;
using math::Row3;
using math::RowMat3;
using math::RowSpatial;
using math::RowSym3;

// Inertial parameters of the moving bodies in their own frames, kept as second moments
// Σ = ∫ r rᵀ dm = ½ tr(I) 1 - I (the 3×3 block of the pseudo-inertia), which rotate and shift with
// less work than I.
template <class T, int Capacity>
struct Inertias {
  Row<T, Capacity> mass;
  Row3<T, Capacity> first;      // m c
  RowSym3<T, Capacity> second;  // Σ about the body frame's origin

  // φ = (m, m c_x, m c_y, m c_z, I_xx, I_xy, I_xz, I_yy, I_yz, I_zz)
  RG_INLINE void Set(int body, const T* phi) {
    mass[body] = phi[0];
    first.x[body] = phi[1];
    first.y[body] = phi[2];
    first.z[body] = phi[3];
    const T half_trace = (phi[4] + phi[7] + phi[9]) * T(0.5);
    second.xx[body] = half_trace - phi[4];
    second.yy[body] = half_trace - phi[7];
    second.zz[body] = half_trace - phi[9];
    second.xy[body] = -phi[5];
    second.xz[body] = -phi[6];
    second.yz[body] = -phi[8];
  }
};

// What is summed over subtrees; Rows throughout, so that the sum is one loop over kRows rows.
template <class T, int Capacity>
struct Composite {
  static constexpr int kRows = 28;
  Row<T, Capacity> mass;
  Row3<T, Capacity> first;        // Σ m r
  RowSym3<T, Capacity> second;    // Σ m r rᵀ
  Row3<T, Capacity> momentum;     // Σ m ṙ
  RowMat3<T, Capacity> mix;       // Σ m ṙ rᵀ
  RowSpatial<T, Capacity> force;  // net force that the motion (V, A0) and gravity need
};

template <class T, int Capacity>
struct KernelWorkspace {
  static constexpr int kCapacity = Capacity;
  using Column = Row<T, Capacity>;

  Row<T, Capacity> q, v, a;

  RowMat3<T, Capacity> R;         // R_WB
  Row3<T, Capacity> p;            // p_WB
  RowSpatial<T, Capacity> S;      // joint axes as motions
  RowSpatial<T, Capacity> V;      // velocities of the bodies
  RowSpatial<T, Capacity> Sdot;   // V × S
  RowSpatial<T, Capacity> A0;     // accelerations at a = 0, base at -g
  RowSpatial<T, Capacity> A;      // accelerations at a, base at -g
  RowSpatial<T, Capacity> Sddot;  // A × S + V × Sdot
  RowSpatial<T, Capacity> delta;  // A - A0
  RowSpatial<T, Capacity>
      added;  // forces being summed: I S a per subtree (Derivatives), per body (InverseDynamics)
  RowSpatial<T, Capacity> F;  // composite inertia times S; dtau_dg is -F.lin
  Row3<T, Capacity> bt;       // angular part of 2 Bᵀ S (the linear part is zero)
  RowSpatial<T, Capacity> up_q, up_v;
  Composite<T, Capacity> sum;

  Column M[Capacity];
  Column c;
  Column tau;
  Column dtau_dq[Capacity];
  Column dtau_dv[Capacity];
  // Column (k, i): d tau / d φ_k[i].
  Column Y[Capacity][10];
};

}  // namespace RG_ISA
}  // namespace rg::dynamics
