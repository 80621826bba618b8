// Rigid-body dynamics kernels in world coordinates over rows of joints.
//
// Everything but three recursions (poses, sums towards the leaves, sums towards the root) is the same
// arithmetic for every joint, so it runs on packs of neighbouring joints; common coordinates make the
// recursions plain additions. The typical sequence, kinematics shared by all of it:
//
//   Terms(tree, inertias, gravity, q, v, w)   -> w.M, w.c          M q̈ + c = tau
//   SetAcceleration(tree, a, w)
//   Derivatives(tree, w)                      -> w.dtau_dq, w.dtau_dv (w.F: dtau_dg = -F.lin)
//   Regressor(tree, w)                        -> w.Y
//
// Derivatives after Singh, Russell & Wensing, "Efficient analytical derivatives of rigid-body dynamics
// using spatial vector algebra", RA-L 2022: with Ṡ = V×S, S̈ = A×S + V×Ṡ and composite I, B, f of the
// subtree of i, j an ancestor of i or i itself,
//   dtau_i/dq_j = (2BᵀS_i)·Ṡ_j + (I S_i)·S̈_j         dtau_i/dv_j = (2BᵀS_i)·S_j + 2 (I S_i)·Ṡ_j
//   dtau_j/dq_i = S_j·(2B Ṡ_i + I S̈_i + S_i ×* f)    dtau_j/dv_i = S_j·(2B S_i + 2 I Ṡ_i)
// B(I, V) has a physical form that makes it cheap: for a body of particles m at r with velocity ṙ,
//   B u = Σ m [r × (α × ṙ); α × ṙ]   for a motion u with angular part α,
// which needs only Σ m ṙ and Σ m ṙ rᵀ, and ignores the linear part of u.
#pragma once

#include "common/dynamics/kernel_workspace.h"
#include "common/dynamics/tree.h"
#include "common/math/sincos.h"

namespace rg::dynamics {
inline namespace RG_ISA {

using math::Mat3;
using math::Spatial;
using math::Sym3;
using math::Vec3;

namespace kernel {

// Calls f(r) for the first joint r of each pack.
template <class T, class F>
RG_INLINE void ForEachPack(const Tree& tree, F f) {
  for (int r = 0; r < tree.n; r += math::kPackWidth<T>) f(r);
}

// rows[i][k] += rows[i][parent of k], from the root to the leaves: sums along the path.
template <class T, int C>
RG_INLINE void SumOutward(const Tree& tree, Row<T, C>* rows, int count) {
  for (int k = 1; k < tree.n; ++k) {
    const int parent = tree.parent[k];
    if (parent < 0) continue;
    for (int i = 0; i < count; ++i) rows[i][k] = rows[i][k] + rows[i][parent];
  }
}

// rows[i][parent of k] += rows[i][k], from the leaves to the root: sums over subtrees.
template <class T, int C>
RG_INLINE void SumInward(const Tree& tree, Row<T, C>* rows, int count) {
  for (int k = tree.n - 1; k > 0; --k) {
    const int parent = tree.parent[k];
    if (parent < 0) continue;
    for (int i = 0; i < count; ++i) rows[i][parent] = rows[i][parent] + rows[i][k];
  }
}

template <class T, int C>
RG_INLINE Row<T, C>* Rows(RowSpatial<T, C>& rows) {
  return &rows.ang.x;
}
template <class T, int C>
RG_INLINE Row<T, C>* Rows(Composite<T, C>& rows) {
  static_assert(sizeof(Composite<T, C>) == Composite<T, C>::kRows * sizeof(Row<T, C>));
  return &rows.mass;
}

template <class T>
RG_INLINE Mat3<T> ConstantMat3(const double* columns) {
  return {{T(columns[0]), T(columns[1]), T(columns[2])},
          {T(columns[3]), T(columns[4]), T(columns[5])},
          {T(columns[6]), T(columns[7]), T(columns[8])}};
}

// Joint row of a constant of the tree.
template <class T>
RG_INLINE Pack<T> LoadConstant(const double* row, int r) {
  if constexpr (math::kPackWidth<T> == 1) {
    return Pack<T>(row[r]);
  } else {
    return math::LoadPack(row + r);
  }
}

// I u for a composite of mass m, first moment h and second moment Σ about the origin.
template <class P>
RG_INLINE Spatial<P> InertiaTimes(P m, const Vec3<P>& h, const Sym3<P>& second, const Spatial<P>& u) {
  return {Cross(h, u.lin) + u.ang * Trace(second) - second * u.ang, u.lin * m + Cross(u.ang, h)};
}

// 2B u; only the angular part of u counts.
template <class P>
RG_INLINE Spatial<P> TwiceBTimes(const Vec3<P>& momentum, const Mat3<P>& mix, const Vec3<P>& ang) {
  const Vec3<P> twice = ang + ang;
  return {twice * Trace(mix) - mix * twice, Cross(twice, momentum)};
}

// Whether any, or all, joints of the pack at r are in a set given by bits.
template <class T>
RG_INLINE bool AnyOf(uint32_t set, int r) {
  return ((set >> r) & ((1u << math::kPackWidth<T>)-1u)) != 0;
}
template <class T>
RG_INLINE bool AllOf(uint32_t set, int r) {
  constexpr uint32_t kFull = (1u << math::kPackWidth<T>)-1u;
  return ((set >> r) & kFull) == kFull;
}

template <class P>
struct Two {
  P first, second;
};

// Column j of two matrices whose entries (r, j) are up(r) for joints r on the path of j (j included),
// down(r) for its descendants, and zero elsewhere.
template <class T, int C, class Up, class Down>
RG_INLINE void FillColumns(const Tree& tree, int j, Row<T, C>& first, Row<T, C>& second, Up up, Down down) {
  ForEachPack<T>(tree, [&](int r) RG_LAMBDA_INLINE {
    Two<Pack<T>> entry = {Pack<T>(0.0), Pack<T>(0.0)};
    if (AnyOf<T>(tree.path[j], r)) {
      entry = up(r);
      if (!AllOf<T>(tree.path[j], r)) {
        const Pack<T> mask = LoadConstant<T>(tree.path_mask[j], r);
        entry = {entry.first * mask, entry.second * mask};
      }
    }
    if (AnyOf<T>(tree.below[j], r)) {
      Two<Pack<T>> lower = down(r);
      if (!AllOf<T>(tree.below[j], r)) {
        const Pack<T> mask = LoadConstant<T>(tree.below_mask[j], r);
        lower = {lower.first * mask, lower.second * mask};
      }
      entry = {entry.first + lower.first, entry.second + lower.second};
    }
    first.Store(r, entry.first);
    second.Store(r, entry.second);
  });
}

}  // namespace kernel

// R, p, S from w.q.
template <class T, int C>
RG_INLINE void Kinematics(const Tree& tree, KernelWorkspace<T, C>& w) {
  Row<T, C> sine, cosine;
  kernel::ForEachPack<T>(tree, [&](int r) RG_LAMBDA_INLINE {
    Pack<T> s, c;
    SinCos(w.q.Load(r) * kernel::LoadConstant<T>(tree.revolute, r), &s, &c);
    sine.Store(r, s);
    cosine.Store(r, c);
  });
  for (int k = 0; k < tree.n; ++k) {
    const int parent = tree.parent[k];
    Mat3<T> R = kernel::ConstantMat3<T>(tree.rotation[k]);
    Vec3<T> p = {T(tree.translation[k][0]), T(tree.translation[k][1]), T(tree.translation[k][2])};
    if (parent >= 0) {
      const Mat3<T> R_parent = w.R.At(parent);
      R = R_parent * R;
      p = R_parent * p + w.p.At(parent);
    }
    w.p.Set(k, p + R.z * (w.q[k] * T(tree.prismatic[k])));
    w.R.Set(k, {R.x * cosine[k] + R.y * sine[k], R.y * cosine[k] - R.x * sine[k], R.z});
  }
  kernel::ForEachPack<T>(tree, [&](int r) RG_LAMBDA_INLINE {
    const Vec3<Pack<T>> z = w.R.z.Load(r);
    const Vec3<Pack<T>> ang = z * kernel::LoadConstant<T>(tree.revolute, r);
    w.S.Store(r, {ang, Cross(w.p.Load(r), ang) + z * kernel::LoadConstant<T>(tree.prismatic, r)});
  });
}

// V, Sdot, A0 from w.v and gravity (3).
template <class T, int C>
RG_INLINE void Velocities(const Tree& tree, const T* gravity, KernelWorkspace<T, C>& w) {
  kernel::ForEachPack<T>(tree, [&](int r) RG_LAMBDA_INLINE { w.V.Store(r, w.S.Load(r) * w.v.Load(r)); });
  kernel::SumOutward(tree, kernel::Rows(w.V), 6);
  kernel::ForEachPack<T>(tree, [&](int r) RG_LAMBDA_INLINE {
    const Spatial<Pack<T>> Sdot = CrossMotion(w.V.Load(r), w.S.Load(r));
    w.Sdot.Store(r, Sdot);
    w.A0.Store(r, Sdot * w.v.Load(r));
  });
  kernel::SumOutward(tree, kernel::Rows(w.A0), 6);
  const Vec3<Pack<T>> minus_g = {Pack<T>(-gravity[0]), Pack<T>(-gravity[1]), Pack<T>(-gravity[2])};
  kernel::ForEachPack<T>(tree,
                         [&](int r) RG_LAMBDA_INLINE { w.A0.lin.Store(r, w.A0.lin.Load(r) + minus_g); });
}

// Inertia of each body about W's origin, into w.sum (not yet summed).
template <class T, int C>
RG_INLINE void BodyInertias(const Tree& tree, const Inertias<T, C>& inertias, KernelWorkspace<T, C>& w) {
  using P = Pack<T>;
  kernel::ForEachPack<T>(tree, [&](int r) RG_LAMBDA_INLINE {
    const Mat3<P> R = w.R.Load(r);
    const Vec3<P> p = w.p.Load(r);
    const P m = inertias.mass.Load(r);
    const Vec3<P> turned = R * inertias.first.Load(r);
    const Vec3<P> half = turned + p * (m * P(0.5));  // h pᵀ + p hᵀ + m p pᵀ = half pᵀ + p halfᵀ
    const Sym3<P> shift = {(half.x * p.x) * P(2.0), half.x * p.y + half.y * p.x, half.x * p.z + half.z * p.x,
                           (half.y * p.y) * P(2.0), half.y * p.z + half.z * p.y, (half.z * p.z) * P(2.0)};
    w.sum.mass.Store(r, m);
    w.sum.first.Store(r, turned + p * m);
    w.sum.second.Store(r, Rotate(R, inertias.second.Load(r)) + shift);
  });
}

// Momentum terms and force of each body in its motion (V, A0), into w.sum (not yet summed).
template <class T, int C>
RG_INLINE void BodyForces(const Tree& tree, KernelWorkspace<T, C>& w) {
  using P = Pack<T>;
  kernel::ForEachPack<T>(tree, [&](int r) RG_LAMBDA_INLINE {
    const P m = w.sum.mass.Load(r);
    const Vec3<P> h = w.sum.first.Load(r);
    const Sym3<P> second = w.sum.second.Load(r);
    const Spatial<P> V = w.V.Load(r);
    const Spatial<P> A = w.A0.Load(r);
    const Vec3<P> momentum = V.lin * m + Cross(V.ang, h);
    const Mat3<P> mix = {Cross(V.ang, ColumnX(second)) + V.lin * h.x,
                         Cross(V.ang, ColumnY(second)) + V.lin * h.y,
                         Cross(V.ang, ColumnZ(second)) + V.lin * h.z};
    const Spatial<P> inertial = kernel::InertiaTimes(m, h, second, A);
    w.sum.momentum.Store(r, momentum);
    w.sum.mix.Store(r, mix);
    w.sum.force.Store(
        r, {inertial.ang + V.ang * Trace(mix) - mix * V.ang, inertial.lin + Cross(V.ang, momentum)});
  });
}

// F = I S of the composites.
template <class T, int C>
RG_INLINE void CompositeForces(const Tree& tree, KernelWorkspace<T, C>& w) {
  kernel::ForEachPack<T>(tree, [&](int r) RG_LAMBDA_INLINE {
    w.F.Store(
        r, kernel::InertiaTimes(w.sum.mass.Load(r), w.sum.first.Load(r), w.sum.second.Load(r), w.S.Load(r)));
  });
}

// M, both triangles, from F.
template <class T, int C>
RG_INLINE void MassMatrix(const Tree& tree, KernelWorkspace<T, C>& w) {
  constexpr int kWidth = math::kPackWidth<T>;
  for (int j = 0; j < tree.n; ++j) {
    const Spatial<Pack<T>> F = w.F.Splat(j);
    for (int r = 0; r <= j; r += kWidth) {
      Pack<T> entry = Dot(w.S.Load(r), F);
      if (!kernel::AllOf<T>(tree.path[j], r)) entry *= kernel::LoadConstant<T>(tree.path_mask[j], r);
      w.M[j].Store(r, entry);
    }
    for (int r = 0; r < j; ++r) w.M[r][j] = w.M[j][r];
  }
}

template <class T, int C>
RG_INLINE void CopyIn(int n, const T* from, Row<T, C>& to) {
  for (int k = 0; k < n; ++k) to[k] = from[k];
}

// M and c at (q, v); q, v: n, gravity: 3 in W.
template <class T, int C>
RG_INLINE void Terms(const Tree& tree, const Inertias<T, C>& inertias, const T* gravity, const T* q,
                     const T* v, KernelWorkspace<T, C>& w) {
  CopyIn(tree.n, q, w.q);
  CopyIn(tree.n, v, w.v);
  Kinematics(tree, w);
  Velocities(tree, gravity, w);
  BodyInertias(tree, inertias, w);
  BodyForces(tree, w);
  kernel::SumInward(tree, kernel::Rows(w.sum), Composite<T, C>::kRows);
  CompositeForces(tree, w);
  MassMatrix(tree, w);
  kernel::ForEachPack<T>(
      tree, [&](int r) RG_LAMBDA_INLINE { w.c.Store(r, Dot(w.S.Load(r), w.sum.force.Load(r))); });
}

// A at the acceleration a (n), after Terms or Rnea's Velocities.
template <class T, int C>
RG_INLINE void SetAcceleration(const Tree& tree, const T* a, KernelWorkspace<T, C>& w) {
  CopyIn(tree.n, a, w.a);
  kernel::ForEachPack<T>(tree, [&](int r) RG_LAMBDA_INLINE { w.delta.Store(r, w.S.Load(r) * w.a.Load(r)); });
  kernel::SumOutward(tree, kernel::Rows(w.delta), 6);
  kernel::ForEachPack<T>(tree, [&](int r) RG_LAMBDA_INLINE { w.A.Store(r, w.A0.Load(r) + w.delta.Load(r)); });
}

// dtau_dq and dtau_dv, after Terms and SetAcceleration. Also w.tau = M a + c.
template <class T, int C>
RG_INLINE void Derivatives(const Tree& tree, KernelWorkspace<T, C>& w) {
  using P = Pack<T>;
  // Force on the subtree of i in its motion at a: what Terms summed at a = 0, plus the subtree's inertia
  // times its parent's share of A - A0, plus I_k S_k a_k of each joint k in it.
  kernel::ForEachPack<T>(tree, [&](int r) RG_LAMBDA_INLINE { w.added.Store(r, w.F.Load(r) * w.a.Load(r)); });
  kernel::SumInward(tree, kernel::Rows(w.added), 6);
  kernel::ForEachPack<T>(tree, [&](int r) RG_LAMBDA_INLINE {
    const Spatial<P> S = w.S.Load(r), V = w.V.Load(r), A = w.A.Load(r), Sdot = w.Sdot.Load(r);
    const Spatial<P> Sddot = CrossMotion(A, S) + CrossMotion(V, Sdot);
    const P m = w.sum.mass.Load(r);
    const Vec3<P> h = w.sum.first.Load(r), momentum = w.sum.momentum.Load(r);
    const Sym3<P> second = w.sum.second.Load(r);
    const Mat3<P> mix = w.sum.mix.Load(r);
    const Spatial<P> delta = w.delta.Load(r) - S * w.a.Load(r);
    const Spatial<P> force =
        w.sum.force.Load(r) + w.added.Load(r) + kernel::InertiaTimes(m, h, second, delta);
    const Vec3<P> half_bt = S.ang * Trace(mix) - TransposeTimes(mix, S.ang) + Cross(momentum, S.lin);
    w.tau.Store(r, Dot(S, force));
    w.Sddot.Store(r, Sddot);
    w.bt.Store(r, half_bt + half_bt);
    w.up_q.Store(r, kernel::TwiceBTimes(momentum, mix, Sdot.ang) + kernel::InertiaTimes(m, h, second, Sddot) +
                        CrossForce(S, force));
    w.up_v.Store(r,
                 kernel::TwiceBTimes(momentum, mix, S.ang) + kernel::InertiaTimes(m, h, second, Sdot + Sdot));
  });
  for (int j = 0; j < tree.n; ++j) {
    const Spatial<P> up_q = w.up_q.Splat(j), up_v = w.up_v.Splat(j);
    const Spatial<P> Sdot = w.Sdot.Splat(j), Sddot = w.Sddot.Splat(j);
    const Spatial<P> twice_Sdot = Sdot + Sdot;
    const Vec3<P> axis = w.S.ang.Splat(j);
    kernel::FillColumns(
        tree, j, w.dtau_dq[j], w.dtau_dv[j],
        [&](int r) RG_LAMBDA_INLINE {
          const Spatial<P> S = w.S.Load(r);
          return kernel::Two<P>{Dot(S, up_q), Dot(S, up_v)};
        },
        [&](int r) RG_LAMBDA_INLINE {
          const Spatial<P> F = w.F.Load(r);
          const Vec3<P> bt = w.bt.Load(r);
          return kernel::Two<P>{Dot(bt, Sdot.ang) + Dot(F, Sddot), Dot(bt, axis) + Dot(F, twice_Sdot)};
        });
  }
}

// Y at (q, v, a), after SetAcceleration (which needs Kinematics and Velocities only).
//
// For body k with angular velocity ω, angular acceleration α and acceleration A of its origin (less
// gravity), all in its own axes, and joint r with axis n that moves the origin along s,
//   dtau_r/dm = s·A     dtau_r/d(mc) = Eᵀ s + A × n, E = α̂ + ω̂ω̂     dtau_r/dI: n I α + (n × ω) I ω
template <class T, int C>
RG_INLINE void Regressor(const Tree& tree, KernelWorkspace<T, C>& w) {
  using P = Pack<T>;
  Row3<T, C> omega, alpha, accel;
  kernel::ForEachPack<T>(tree, [&](int r) RG_LAMBDA_INLINE {
    const Mat3<P> R = w.R.Load(r);
    const Vec3<P> p = w.p.Load(r);
    const Spatial<P> V = w.V.Load(r), A = w.A.Load(r);
    const Vec3<P> velocity = V.lin + Cross(V.ang, p);
    omega.Store(r, TransposeTimes(R, V.ang));
    alpha.Store(r, TransposeTimes(R, A.ang));
    accel.Store(r, TransposeTimes(R, A.lin + Cross(A.ang, p) + Cross(V.ang, velocity)));
  });
  for (int k = 0; k < tree.n; ++k) {
    const Mat3<P> R = w.R.Splat(k);
    const Vec3<P> p = w.p.Splat(k), o = omega.Splat(k), al = alpha.Splat(k), acc = accel.Splat(k);
    const P xx = o.x * o.x, yy = o.y * o.y, zz = o.z * o.z, xy = o.x * o.y, xz = o.x * o.z, yz = o.y * o.z;
    const Mat3<P> E = {{-(yy + zz), xy + al.z, xz - al.y},
                       {xy - al.z, -(xx + zz), yz + al.x},
                       {xz + al.y, yz - al.x, -(xx + yy)}};
    Row<T, C>* Y = w.Y[k];
    for (int r = 0; r <= k; r += math::kPackWidth<T>) {
      Spatial<P> S = w.S.Load(r);
      if (!kernel::AllOf<T>(tree.path[k], r)) S = S * kernel::LoadConstant<T>(tree.path_mask[k], r);
      const Vec3<P> axis = S.ang;
      const Vec3<P> moved = S.lin + Cross(axis, p);
      const Vec3<P> n = TransposeTimes(R, axis), s = TransposeTimes(R, moved), u = Cross(n, o);
      const Vec3<P> first = TransposeTimes(E, s) + Cross(acc, n);
      Y[0].Store(r, Dot(s, acc));
      Y[1].Store(r, first.x);
      Y[2].Store(r, first.y);
      Y[3].Store(r, first.z);
      Y[4].Store(r, n.x * al.x + u.x * o.x);
      Y[5].Store(r, n.x * al.y + n.y * al.x + u.x * o.y + u.y * o.x);
      Y[6].Store(r, n.x * al.z + n.z * al.x + u.x * o.z + u.z * o.x);
      Y[7].Store(r, n.y * al.y + u.y * o.y);
      Y[8].Store(r, n.y * al.z + n.z * al.y + u.y * o.z + u.z * o.y);
      Y[9].Store(r, n.z * al.z + u.z * o.z);
    }
  }
}

// w.tau = inverse dynamics at (q, v, a).
template <class T, int C>
RG_INLINE void InverseDynamics(const Tree& tree, const Inertias<T, C>& inertias, const T* gravity, const T* q,
                               const T* v, const T* a, KernelWorkspace<T, C>& w) {
  using P = Pack<T>;
  CopyIn(tree.n, q, w.q);
  CopyIn(tree.n, v, w.v);
  CopyIn(tree.n, a, w.a);
  Kinematics(tree, w);
  kernel::ForEachPack<T>(tree, [&](int r) RG_LAMBDA_INLINE { w.V.Store(r, w.S.Load(r) * w.v.Load(r)); });
  kernel::SumOutward(tree, kernel::Rows(w.V), 6);
  kernel::ForEachPack<T>(tree, [&](int r) RG_LAMBDA_INLINE {
    const Spatial<P> S = w.S.Load(r);
    w.A.Store(r, CrossMotion(w.V.Load(r), S) * w.v.Load(r) + S * w.a.Load(r));
  });
  kernel::SumOutward(tree, kernel::Rows(w.A), 6);
  const Vec3<P> minus_g = {P(-gravity[0]), P(-gravity[1]), P(-gravity[2])};
  // The force on each body in its own axes about its own origin (Newton, Euler), then taken to W.
  kernel::ForEachPack<T>(tree, [&](int r) RG_LAMBDA_INLINE {
    const Mat3<P> R = w.R.Load(r);
    const Vec3<P> p = w.p.Load(r);
    const Spatial<P> V = w.V.Load(r), A = w.A.Load(r);
    const Vec3<P> velocity = V.lin + Cross(V.ang, p);
    const Vec3<P> o = TransposeTimes(R, V.ang), al = TransposeTimes(R, A.ang);
    const Vec3<P> acc = TransposeTimes(R, A.lin + minus_g + Cross(A.ang, p) + Cross(V.ang, velocity));
    const P m = inertias.mass.Load(r);
    const Vec3<P> h = inertias.first.Load(r);
    const Sym3<P> second = inertias.second.Load(r);
    // ω × Iω = -ω × Σω, since the part of I along ω drops out.
    const Vec3<P> moment = Cross(h, acc) + al * Trace(second) - second * al - Cross(o, second * o);
    const Vec3<P> force = R * (acc * m + Cross(al, h) + Cross(o, Cross(o, h)));
    w.added.Store(r, {R * moment + Cross(p, force), force});
  });
  kernel::SumInward(tree, kernel::Rows(w.added), 6);
  kernel::ForEachPack<T>(tree,
                         [&](int r) RG_LAMBDA_INLINE { w.tau.Store(r, Dot(w.S.Load(r), w.added.Load(r))); });
}

// w.M at q alone.
template <class T, int C>
RG_INLINE void CompositeRigidBody(const Tree& tree, const Inertias<T, C>& inertias, const T* q,
                                  KernelWorkspace<T, C>& w) {
  CopyIn(tree.n, q, w.q);
  Kinematics(tree, w);
  BodyInertias(tree, inertias, w);
  kernel::SumInward(tree, kernel::Rows(w.sum), 10);
  CompositeForces(tree, w);
  MassMatrix(tree, w);
}

}  // namespace RG_ISA
}  // namespace rg::dynamics
