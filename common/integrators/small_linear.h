// Cholesky, inverse and products of small dense matrices (n ≤ C), row-major with leading dimension C.
#pragma once

#include "common/math/isa.h"

namespace rg::integrators {
inline namespace RG_ISA {

// A = L Lᵀ in place of A's lower triangle, with 1/L_ii in `inverse_diagonal`. Returns the first row whose
// pivot is not positive (or not a number), -1 if there is none.
template <int C>
RG_INLINE int Cholesky(int n, double* A, double* inverse_diagonal) {
  for (int j = 0; j < n; ++j) {
    double pivot = A[j * C + j];
    for (int k = 0; k < j; ++k) pivot -= A[j * C + k] * A[j * C + k];
    if (!(pivot > 0)) return j;
    const double root = __builtin_sqrt(pivot);
    A[j * C + j] = root;
    inverse_diagonal[j] = 1.0 / root;
    for (int i = j + 1; i < n; ++i) {
      double sum = A[i * C + j];
      for (int k = 0; k < j; ++k) sum -= A[i * C + k] * A[j * C + k];
      A[i * C + j] = sum * inverse_diagonal[j];
    }
  }
  return -1;
}

template <int C>
RG_INLINE void CholeskySolve(int n, const double* L, const double* inverse_diagonal, double* x) {
  for (int i = 0; i < n; ++i) {
    double sum = x[i];
    for (int k = 0; k < i; ++k) sum -= L[i * C + k] * x[k];
    x[i] = sum * inverse_diagonal[i];
  }
  for (int i = n - 1; i >= 0; --i) {
    double sum = x[i];
    for (int k = i + 1; k < n; ++k) sum -= L[k * C + i] * x[k];
    x[i] = sum * inverse_diagonal[i];
  }
}

// 1/(A⁻¹)_ii for A = L Lᵀ.
template <int C>
RG_INLINE void EffectiveInertias(int n, const double* L, const double* inverse_diagonal, double* inertia) {
  double column[C];
  for (int j = 0; j < n; ++j) {  // column j of L⁻¹
    column[j] = inverse_diagonal[j];
    double sum = column[j] * column[j];
    for (int i = j + 1; i < n; ++i) {
      double x = 0;
      for (int k = j; k < i; ++k) x -= L[i * C + k] * column[k];
      column[i] = x * inverse_diagonal[i];
      sum += column[i] * column[i];
    }
    inertia[j] = 1.0 / sum;
  }
}

// A⁻¹ by Gauss-Jordan without pivoting, for A whose symmetric part is positive definite. False where a
// pivot vanishes or is not a number.
template <int C>
RG_INLINE bool Invert(int n, double* A) {
  for (int k = 0; k < n; ++k) {
    const double pivot = A[k * C + k];
    if (!(pivot > 0 || pivot < 0)) return false;
    const double inverse = 1.0 / pivot;
    A[k * C + k] = 1.0;
    for (int j = 0; j < C; ++j) A[k * C + j] *= inverse;
    for (int i = 0; i < n; ++i) {
      if (i == k) continue;
      const double factor = A[i * C + k];
      A[i * C + k] = 0.0;
      for (int j = 0; j < C; ++j) A[i * C + j] -= factor * A[k * C + j];
    }
  }
  return true;
}

}  // namespace RG_ISA
}  // namespace rg::integrators
