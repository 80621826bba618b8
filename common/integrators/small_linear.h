// Cholesky, inverse and products of small dense matrices (n ≤ C), row-major with leading dimension C.
#pragma once

#include "common/dynamics/tree.h"
#include "common/math/dense_kernels.h"

namespace rg::integrators {
inline namespace RG_ISA {

using math::All;
using math::And;
using math::Any;
using math::Not;
using math::Or;
using math::Select;

// A = L Lᵀ in place of A's lower triangle, with 1/L_ii in `inverse_diagonal`. Where a pivot is not positive
// (or not a number) the result is true and `row`, if negative, is set to the pivot's row; the other lanes'
// factors are good.
template <class T, int C>
RG_INLINE math::Mask<T> Cholesky(int n, T* A, T* inverse_diagonal, int* row) {
  math::Mask<T> bad = false;
  for (int j = 0; j < n; ++j) {
    T pivot = A[j * C + j];
    for (int k = 0; k < j; ++k) pivot -= A[j * C + k] * A[j * C + k];
    const math::Mask<T> fails = Not(pivot > T(0.0));
    if (Any(fails)) [[unlikely]] {
      if (*row < 0) *row = j;
      bad = Or(bad, fails);
      if (All(bad)) return bad;
    }
    const T root = math::Sqrt(pivot);
    A[j * C + j] = root;
    inverse_diagonal[j] = T(1.0) / root;
    for (int i = j + 1; i < n; ++i) {
      T sum = A[i * C + j];
      for (int k = 0; k < j; ++k) sum -= A[i * C + k] * A[j * C + k];
      A[i * C + j] = sum * inverse_diagonal[j];
    }
  }
  return bad;
}

template <class T, int C>
RG_INLINE void CholeskySolve(int n, const T* L, const T* inverse_diagonal, T* x) {
  for (int i = 0; i < n; ++i) {
    T sum = x[i];
    for (int k = 0; k < i; ++k) sum -= L[i * C + k] * x[k];
    x[i] = sum * inverse_diagonal[i];
  }
  for (int i = n - 1; i >= 0; --i) {
    T sum = x[i];
    for (int k = i + 1; k < n; ++k) sum -= L[k * C + i] * x[k];
    x[i] = sum * inverse_diagonal[i];
  }
}

// 1/(A⁻¹)_ii for A = L Lᵀ.
template <class T, int C>
RG_INLINE void EffectiveInertias(int n, const T* L, const T* inverse_diagonal, T* inertia) {
  T column[C];
  for (int j = 0; j < n; ++j) {  // column j of L⁻¹
    column[j] = inverse_diagonal[j];
    T sum = column[j] * column[j];
    for (int i = j + 1; i < n; ++i) {
      T x = T(0.0);
      for (int k = j; k < i; ++k) x -= L[i * C + k] * column[k];
      column[i] = x * inverse_diagonal[i];
      sum += column[i] * column[i];
    }
    inertia[j] = T(1.0) / sum;
  }
}

// Column j of the unit matrix.
alignas(64) inline constexpr double kUnit[dynamics::kMaxBodies][dynamics::kMaxBodies] = {
    {1},
    {0, 1},
    {0, 0, 1},
    {0, 0, 0, 1},
    {0, 0, 0, 0, 1},
    {0, 0, 0, 0, 0, 1},
    {0, 0, 0, 0, 0, 0, 1},
    {0, 0, 0, 0, 0, 0, 0, 1},
    {0, 0, 0, 0, 0, 0, 0, 0, 1},
    {0, 0, 0, 0, 0, 0, 0, 0, 0, 1},
    {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1},
    {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1},
    {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1},
    {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1},
    {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1},
    {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1}};

// The pack at r of x·(column j of the unit matrix).
template <class T>
RG_INLINE math::Pack<T> AlongUnit(int j, int r, math::Pack<T> x) {
  if constexpr (math::kPackWidth<T> == 1) {
    return r == j ? x : T(0.0);
  } else {
    return math::LoadPack(kUnit[j] + r) * x;
  }
}

// A⁻¹ by Gauss-Jordan without pivoting, for A whose symmetric part is positive definite; column by column (or
// row by row). True where a pivot vanishes or is not a number.
template <class T, int C>
RG_INLINE math::Mask<T> Invert(int n, math::Row<T, C>* A) {
  constexpr int kWidth = math::kPackWidth<T>;
  math::Mask<T> bad = false;
  for (int k = 0; k < n; ++k) {
    const T pivot = A[k][k];
    bad = Or(bad, Not(Or(pivot > T(0.0), pivot < T(0.0))));
    const T inverse = T(1.0) / pivot;
    T factor[C];
    for (int i = 0; i < n; ++i) factor[i] = A[i][k];
    for (int r = 0; r < n; r += kWidth) {
      const math::Pack<T> unit = AlongUnit<T>(k, r, math::Pack<T>(T(1.0)));
      const math::Pack<T> scaled =
          (A[k].Load(r) + unit * math::Pack<T>(T(1.0) - pivot)) * math::Pack<T>(inverse);
      const math::Pack<T> other = scaled + unit;
      for (int i = 0; i < n; ++i) {
        if (i != k) A[i].Store(r, A[i].Load(r) - math::Pack<T>(factor[i]) * other);
      }
      A[k].Store(r, scaled);
    }
  }
  return bad;
}

}  // namespace RG_ISA
}  // namespace rg::integrators
