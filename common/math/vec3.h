// Three-vectors, 3×3 and symmetric 3×3 matrices over a kernel scalar T (double, Lanes, Pack).
#pragma once

#include "common/math/isa.h"

namespace rg::math {
inline namespace RG_ISA {

template <class T>
struct Vec3 {
  T x, y, z;

  friend RG_INLINE Vec3 operator+(const Vec3& a, const Vec3& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
  friend RG_INLINE Vec3 operator-(const Vec3& a, const Vec3& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
  friend RG_INLINE Vec3 operator-(const Vec3& a) { return {-a.x, -a.y, -a.z}; }
  friend RG_INLINE Vec3 operator*(const Vec3& a, T s) { return {a.x * s, a.y * s, a.z * s}; }
  friend RG_INLINE Vec3 operator*(T s, const Vec3& a) { return {a.x * s, a.y * s, a.z * s}; }
};

template <class T>
RG_INLINE T Dot(const Vec3<T>& a, const Vec3<T>& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
template <class T>
RG_INLINE Vec3<T> Cross(const Vec3<T>& a, const Vec3<T>& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// Columns x, y, z.
template <class T>
struct Mat3 {
  Vec3<T> x, y, z;

  friend RG_INLINE Vec3<T> operator*(const Mat3& A, const Vec3<T>& b) {
    return A.x * b.x + A.y * b.y + A.z * b.z;
  }
  friend RG_INLINE Mat3 operator*(const Mat3& A, const Mat3& B) { return {A * B.x, A * B.y, A * B.z}; }
  friend RG_INLINE Mat3 operator+(const Mat3& A, const Mat3& B) { return {A.x + B.x, A.y + B.y, A.z + B.z}; }
};

// Aᵀ b
template <class T>
RG_INLINE Vec3<T> TransposeTimes(const Mat3<T>& A, const Vec3<T>& b) {
  return {Dot(A.x, b), Dot(A.y, b), Dot(A.z, b)};
}
template <class T>
RG_INLINE T Trace(const Mat3<T>& A) {
  return A.x.x + A.y.y + A.z.z;
}

template <class T>
struct Sym3 {
  T xx, xy, xz, yy, yz, zz;

  friend RG_INLINE Vec3<T> operator*(const Sym3& A, const Vec3<T>& b) {
    return {A.xx * b.x + A.xy * b.y + A.xz * b.z, A.xy * b.x + A.yy * b.y + A.yz * b.z,
            A.xz * b.x + A.yz * b.y + A.zz * b.z};
  }
  friend RG_INLINE Sym3 operator+(const Sym3& A, const Sym3& B) {
    return {A.xx + B.xx, A.xy + B.xy, A.xz + B.xz, A.yy + B.yy, A.yz + B.yz, A.zz + B.zz};
  }
};

template <class T>
RG_INLINE T Trace(const Sym3<T>& A) {
  return A.xx + A.yy + A.zz;
}
template <class T>
RG_INLINE Vec3<T> ColumnX(const Sym3<T>& A) {
  return {A.xx, A.xy, A.xz};
}
template <class T>
RG_INLINE Vec3<T> ColumnY(const Sym3<T>& A) {
  return {A.xy, A.yy, A.yz};
}
template <class T>
RG_INLINE Vec3<T> ColumnZ(const Sym3<T>& A) {
  return {A.xz, A.yz, A.zz};
}
// R A Rᵀ
template <class T>
RG_INLINE Sym3<T> Rotate(const Mat3<T>& R, const Sym3<T>& A) {
  const Mat3<T> RA = {R * ColumnX(A), R * ColumnY(A), R * ColumnZ(A)};
  const Vec3<T> row_x = {R.x.x, R.y.x, R.z.x}, row_y = {R.x.y, R.y.y, R.z.y}, row_z = {R.x.z, R.y.z, R.z.z};
  const Vec3<T> ra_x = {RA.x.x, RA.y.x, RA.z.x}, ra_y = {RA.x.y, RA.y.y, RA.z.y},
                ra_z = {RA.x.z, RA.y.z, RA.z.z};
  return {Dot(ra_x, row_x), Dot(ra_x, row_y), Dot(ra_x, row_z),
          Dot(ra_y, row_y), Dot(ra_y, row_z), Dot(ra_z, row_z)};
}

// Spatial vectors, angular part first. As a motion: angular velocity, and the velocity of the
// body-fixed point that passes the origin. As a force: moment about the origin, and force.
template <class T>
struct Spatial {
  Vec3<T> ang, lin;

  friend RG_INLINE Spatial operator+(const Spatial& a, const Spatial& b) {
    return {a.ang + b.ang, a.lin + b.lin};
  }
  friend RG_INLINE Spatial operator-(const Spatial& a, const Spatial& b) {
    return {a.ang - b.ang, a.lin - b.lin};
  }
  friend RG_INLINE Spatial operator*(const Spatial& a, T s) { return {a.ang * s, a.lin * s}; }
};
template <class T>
RG_INLINE T Dot(const Spatial<T>& a, const Spatial<T>& b) {
  return Dot(a.ang, b.ang) + Dot(a.lin, b.lin);
}
// Motion × motion.
template <class T>
RG_INLINE Spatial<T> CrossMotion(const Spatial<T>& a, const Spatial<T>& b) {
  return {Cross(a.ang, b.ang), Cross(a.ang, b.lin) + Cross(a.lin, b.ang)};
}
// Motion ×* force.
template <class T>
RG_INLINE Spatial<T> CrossForce(const Spatial<T>& a, const Spatial<T>& f) {
  return {Cross(a.ang, f.ang) + Cross(a.lin, f.lin), Cross(a.ang, f.lin)};
}

}  // namespace RG_ISA
}  // namespace rg::math
