// Structure of arrays over joints: one row of T per component, column k belongs to joint k.
//
// Kernels read and write a row Pack<T> by Pack<T> (all neighbouring joints at once) where joints do
// not depend on each other, and element by element along recursions. Capacity is a multiple of the
// pack width; elements past the last joint are zero at the start and stay finite.
#pragma once

#include "common/math/lanes.h"
#include "common/math/vec3.h"

namespace rg::math {
inline namespace RG_ISA {

template <class T, int Capacity>
struct Row {
  alignas(64) T c[Capacity] = {};

  RG_INLINE T& operator[](int k) { return c[k]; }
  RG_INLINE const T& operator[](int k) const { return c[k]; }
  RG_INLINE Pack<T> Load(int r) const { return LoadPack(c + r); }
  RG_INLINE void Store(int r, Pack<T> x) { StorePack(c + r, x); }
  // The element of one joint, in every lane of a pack.
  RG_INLINE Pack<T> Splat(int k) const { return Pack<T>(c[k]); }
};

template <class T, int Capacity>
struct Row3 {
  Row<T, Capacity> x, y, z;

  RG_INLINE Vec3<T> At(int k) const { return {x[k], y[k], z[k]}; }
  RG_INLINE void Set(int k, const Vec3<T>& a) {
    x[k] = a.x;
    y[k] = a.y;
    z[k] = a.z;
  }
  RG_INLINE Vec3<Pack<T>> Load(int r) const { return {x.Load(r), y.Load(r), z.Load(r)}; }
  RG_INLINE void Store(int r, const Vec3<Pack<T>>& a) {
    x.Store(r, a.x);
    y.Store(r, a.y);
    z.Store(r, a.z);
  }
  RG_INLINE Vec3<Pack<T>> Splat(int k) const { return {x.Splat(k), y.Splat(k), z.Splat(k)}; }
};

template <class T, int Capacity>
struct RowMat3 {
  Row3<T, Capacity> x, y, z;  // columns

  RG_INLINE Mat3<T> At(int k) const { return {x.At(k), y.At(k), z.At(k)}; }
  RG_INLINE void Set(int k, const Mat3<T>& A) {
    x.Set(k, A.x);
    y.Set(k, A.y);
    z.Set(k, A.z);
  }
  RG_INLINE Mat3<Pack<T>> Load(int r) const { return {x.Load(r), y.Load(r), z.Load(r)}; }
  RG_INLINE void Store(int r, const Mat3<Pack<T>>& A) {
    x.Store(r, A.x);
    y.Store(r, A.y);
    z.Store(r, A.z);
  }
  RG_INLINE Mat3<Pack<T>> Splat(int k) const { return {x.Splat(k), y.Splat(k), z.Splat(k)}; }
};

template <class T, int Capacity>
struct RowSym3 {
  Row<T, Capacity> xx, xy, xz, yy, yz, zz;

  RG_INLINE Sym3<Pack<T>> Load(int r) const {
    return {xx.Load(r), xy.Load(r), xz.Load(r), yy.Load(r), yz.Load(r), zz.Load(r)};
  }
  RG_INLINE void Store(int r, const Sym3<Pack<T>>& A) {
    xx.Store(r, A.xx);
    xy.Store(r, A.xy);
    xz.Store(r, A.xz);
    yy.Store(r, A.yy);
    yz.Store(r, A.yz);
    zz.Store(r, A.zz);
  }
  RG_INLINE Sym3<T> At(int k) const { return {xx[k], xy[k], xz[k], yy[k], yz[k], zz[k]}; }
};

template <class T, int Capacity>
struct RowSpatial {
  Row3<T, Capacity> ang, lin;

  RG_INLINE Spatial<T> At(int k) const { return {ang.At(k), lin.At(k)}; }
  RG_INLINE void Set(int k, const Spatial<T>& a) {
    ang.Set(k, a.ang);
    lin.Set(k, a.lin);
  }
  RG_INLINE Spatial<Pack<T>> Load(int r) const { return {ang.Load(r), lin.Load(r)}; }
  RG_INLINE void Store(int r, const Spatial<Pack<T>>& a) {
    ang.Store(r, a.ang);
    lin.Store(r, a.lin);
  }
  RG_INLINE Spatial<Pack<T>> Splat(int k) const { return {ang.Splat(k), lin.Splat(k)}; }
};

}  // namespace RG_ISA
}  // namespace rg::math
