// Small dense linear algebra for kernels: n ≤ Capacity, column-major, one Row per column.
#pragma once

#include "common/math/rows.h"

namespace rg::math {
inline namespace RG_ISA {

// A ← A⁻¹ for a symmetric positive definite A (both triangles given and returned), by Gauss-Jordan
// elimination without pivoting; returns the smallest pivot. A is positive definite iff that is > 0;
// a pivot of 0 gives non-finite entries. n³ multiply-adds.
template <class T, int C>
RG_INLINE T InvertSpd(int n, Row<T, C>* A) {
  constexpr int kWidth = kPackWidth<T>;
  T smallest = A[0][0];
  for (int k = 0; k < n; ++k) {
    const T pivot = A[k][k];
    smallest = Min(smallest, pivot);
    const T inverse = T(1.0) / pivot;
    Row<T, C> column;  // column k of the old A; entry k such that row k of the update is right
    for (int r = 0; r < n; r += kWidth) column.Store(r, A[k].Load(r));
    column[k] = pivot - T(1.0);
    for (int j = 0; j < n; ++j) {
      if (j == k) continue;
      const Pack<T> factor = Pack<T>(A[j][k] * inverse);
      for (int r = 0; r < n; r += kWidth) A[j].Store(r, A[j].Load(r) - column.Load(r) * factor);
    }
    const Pack<T> scale = Pack<T>(-inverse);
    for (int r = 0; r < n; r += kWidth) A[k].Store(r, column.Load(r) * scale);
    A[k][k] = inverse;
  }
  return smallest;
}

// y = A x
template <class T, int C>
RG_INLINE void MatrixTimes(int n, const Row<T, C>* A, const Row<T, C>& x, Row<T, C>& y) {
  for (int r = 0; r < n; r += kPackWidth<T>) {
    Pack<T> sum = A[0].Load(r) * x.Splat(0);
    for (int j = 1; j < n; ++j) sum += A[j].Load(r) * x.Splat(j);
    y.Store(r, sum);
  }
}

}  // namespace RG_ISA
}  // namespace rg::math
