// Forward dynamics by the articulated-body algorithm (Featherstone, Rigid Body Dynamics Algorithms,
// 2008, section 7.3), in world coordinates.
//
// The velocity-product accelerations are summed outward first (A0), so that the inward pass carries
// the force at A0 and the outward pass only what the joints' own accelerations add.
#pragma once

#include "common/dynamics/kernels.h"

namespace rg::dynamics {
inline namespace RG_ISA {

namespace kernel {

// Symmetric 6×6 inertia: moment = J α + H a, force = Hᵀ α + L a.
template <class T>
struct ArticulatedInertia {
  Sym3<T> J;
  Mat3<T> H;
  Sym3<T> L;

  RG_INLINE Spatial<T> Times(const Spatial<T>& u) const {
    return {J * u.ang + H * u.lin, TransposeTimes(H, u.ang) + L * u.lin};
  }
  RG_INLINE ArticulatedInertia operator+(const ArticulatedInertia& other) const {
    return {J + other.J, H + other.H, L + other.L};
  }
  // this - U Uᵀ / d
  RG_INLINE ArticulatedInertia Without(const Spatial<T>& U, T one_over_d) const {
    const Vec3<T> a = U.ang, l = U.lin, sa = U.ang * one_over_d, sl = U.lin * one_over_d;
    return {{J.xx - sa.x * a.x, J.xy - sa.x * a.y, J.xz - sa.x * a.z, J.yy - sa.y * a.y, J.yz - sa.y * a.z,
             J.zz - sa.z * a.z},
            {H.x - a * sl.x, H.y - a * sl.y, H.z - a * sl.z},
            {L.xx - sl.x * l.x, L.xy - sl.x * l.y, L.xz - sl.x * l.z, L.yy - sl.y * l.y, L.yz - sl.y * l.z,
             L.zz - sl.z * l.z}};
  }
};

}  // namespace kernel

// w.a = M⁻¹ (tau - c) at (q, v), by way of w.sum, which afterwards holds the bodies' own sums.
template <class T, int C>
RG_INLINE void ForwardDynamics(const Tree& tree, const Inertias<T, C>& inertias, const T* gravity, const T* q,
                               const T* v, const T* tau, KernelWorkspace<T, C>& w) {
  CopyIn(tree.n, q, w.q);
  CopyIn(tree.n, v, w.v);
  Kinematics(tree, w);
  Velocities(tree, gravity, w);
  BodyInertias(tree, inertias, w);
  BodyForces(tree, w);

  kernel::ArticulatedInertia<T> inertia[C];
  Spatial<T> bias[C], U[C];
  T one_over_d[C], u[C];
  for (int k = 0; k < tree.n; ++k) {
    const T m = w.sum.mass[k];
    const Vec3<T> h = w.sum.first.At(k);
    const Sym3<T> s = w.sum.second.At(k);
    const T zero = T(0.0);
    inertia[k] = {{s.yy + s.zz, -s.xy, -s.xz, s.xx + s.zz, -s.yz, s.xx + s.yy},
                  {{zero, h.z, -h.y}, {-h.z, zero, h.x}, {h.y, -h.x, zero}},
                  {m, zero, zero, m, zero, m}};
    bias[k] = w.sum.force.At(k);
  }
  for (int k = tree.n - 1; k >= 0; --k) {
    const Spatial<T> S = w.S.At(k);
    U[k] = inertia[k].Times(S);
    one_over_d[k] = T(1.0) / Dot(S, U[k]);
    u[k] = tau[k] - Dot(S, bias[k]);
    const int parent = tree.parent[k];
    if (parent < 0) continue;
    inertia[parent] = inertia[parent] + inertia[k].Without(U[k], one_over_d[k]);
    bias[parent] = bias[parent] + bias[k] + U[k] * (u[k] * one_over_d[k]);
  }
  Spatial<T> added[C];
  for (int k = 0; k < tree.n; ++k) {
    const int parent = tree.parent[k];
    const Spatial<T> S = w.S.At(k);
    if (parent < 0) {
      w.a[k] = u[k] * one_over_d[k];
      added[k] = S * w.a[k];
    } else {
      w.a[k] = (u[k] - Dot(U[k], added[parent])) * one_over_d[k];
      added[k] = added[parent] + S * w.a[k];
    }
  }
}

}  // namespace RG_ISA
}  // namespace rg::dynamics
