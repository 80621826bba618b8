// Lanes<N>: N doubles that a kernel treats as one number.
//
// A kernel written over a scalar T runs one problem with T = double, and N independent problems with
// T = Lanes<N>. With T = double the same kernel may instead use the lanes for N neighbouring joints:
// Pack<T> is what one row operation works on, kPackWidth<T> how many joints it covers (rows.h).
// No branches on values: use Select. All functions are inlined into units of one instruction set.
#pragma once

#include "common/math/isa.h"

namespace rg::math {
inline namespace RG_ISA {

// The compiler's vector types (a vector_size that depends on a template's argument is mistreated).
template <int N>
struct VectorTypes;
template <>
struct VectorTypes<2> {
  typedef double Vector __attribute__((vector_size(16)));
  typedef long Bits __attribute__((vector_size(16)));
};
template <>
struct VectorTypes<4> {
  typedef double Vector __attribute__((vector_size(32)));
  typedef long Bits __attribute__((vector_size(32)));
};
template <>
struct VectorTypes<8> {
  typedef double Vector __attribute__((vector_size(64)));
  typedef long Bits __attribute__((vector_size(64)));
};

template <int N>
struct Lanes {
  using Vector = typename VectorTypes<N>::Vector;
  using Bits = typename VectorTypes<N>::Bits;

  Vector v;

  RG_INLINE Lanes() : v{} {}
  RG_INLINE Lanes(double x) : v(x - Vector{}) {}  // NOLINT: a constant is the same in all lanes
  RG_INLINE Lanes(Vector x) : v(x) {}             // NOLINT

  RG_INLINE double operator[](int lane) const { return v[lane]; }
  RG_INLINE void Set(int lane, double x) { v[lane] = x; }

  friend RG_INLINE Lanes operator+(Lanes a, Lanes b) { return a.v + b.v; }
  friend RG_INLINE Lanes operator-(Lanes a, Lanes b) { return a.v - b.v; }
  friend RG_INLINE Lanes operator*(Lanes a, Lanes b) { return a.v * b.v; }
  friend RG_INLINE Lanes operator/(Lanes a, Lanes b) { return a.v / b.v; }
  friend RG_INLINE Lanes operator-(Lanes a) { return -a.v; }
  RG_INLINE Lanes& operator+=(Lanes b) { return *this = *this + b; }
  RG_INLINE Lanes& operator-=(Lanes b) { return *this = *this - b; }
  RG_INLINE Lanes& operator*=(Lanes b) { return *this = *this * b; }
};

// A truth value per lane.
template <int N>
struct LaneMask {
  typename Lanes<N>::Bits bits;  // 0 or -1

  friend RG_INLINE LaneMask operator&(LaneMask a, LaneMask b) { return {a.bits & b.bits}; }
  friend RG_INLINE LaneMask operator|(LaneMask a, LaneMask b) { return {a.bits | b.bits}; }
};

template <int N>
RG_INLINE LaneMask<N> operator<(Lanes<N> a, Lanes<N> b) {
  return {a.v < b.v};
}
template <int N>
RG_INLINE LaneMask<N> operator<=(Lanes<N> a, Lanes<N> b) {
  return {a.v <= b.v};
}
template <int N>
RG_INLINE LaneMask<N> operator>(Lanes<N> a, Lanes<N> b) {
  return {a.v > b.v};
}
template <int N>
RG_INLINE LaneMask<N> operator>=(Lanes<N> a, Lanes<N> b) {
  return {a.v >= b.v};
}

template <int N>
RG_INLINE Lanes<N> Select(LaneMask<N> mask, Lanes<N> yes, Lanes<N> no) {
  return mask.bits ? yes.v : no.v;
}
RG_INLINE double Select(bool mask, double yes, double no) { return mask ? yes : no; }

template <int N>
RG_INLINE bool All(LaneMask<N> mask) {
  long all = -1;
  for (int i = 0; i < N; ++i) all &= mask.bits[i];
  return all != 0;
}
RG_INLINE bool All(bool mask) { return mask; }

RG_INLINE double Sqrt(double x) { return __builtin_sqrt(x); }
template <int N>
RG_INLINE Lanes<N> Sqrt(Lanes<N> x) {
  Lanes<N> out;
  for (int i = 0; i < N; ++i) out.v[i] = __builtin_sqrt(x.v[i]);
  return out;
}

RG_INLINE double Abs(double x) { return __builtin_fabs(x); }
template <int N>
RG_INLINE Lanes<N> Abs(Lanes<N> x) {
  using L = Lanes<N>;
  return (typename L::Vector)((typename L::Bits)x.v & ~(typename L::Bits)(L(-0.0).v));
}

template <class T>
RG_INLINE T Min(T a, T b) {
  return Select(a < b, a, b);
}
template <class T>
RG_INLINE T Max(T a, T b) {
  return Select(a > b, a, b);
}

// The number at all lanes (T = double) or its own lanes: what row kernels multiply rows with.
template <class T>
struct PackOf;
template <>
struct PackOf<double> {
  using Type = Lanes<kNativeLanes>;
  static constexpr int kWidth = kNativeLanes;
};
template <int N>
struct PackOf<Lanes<N>> {
  using Type = Lanes<N>;
  static constexpr int kWidth = 1;
};
template <class T>
using Pack = typename PackOf<T>::Type;
template <class T>
inline constexpr int kPackWidth = PackOf<T>::kWidth;

// Rows are arrays of T, aligned to a register; `row` points at an element divisible by kPackWidth<T>.
RG_INLINE Pack<double> LoadPack(const double* row) {
  return *reinterpret_cast<const Pack<double>::Vector*>(__builtin_assume_aligned(row, 8 * kNativeLanes));
}
RG_INLINE void StorePack(double* row, Pack<double> x) {
  *reinterpret_cast<Pack<double>::Vector*>(__builtin_assume_aligned(row, 8 * kNativeLanes)) = x.v;
}
template <int N>
RG_INLINE Lanes<N> LoadPack(const Lanes<N>* row) {
  return *row;
}
template <int N>
RG_INLINE void StorePack(Lanes<N>* row, Lanes<N> x) {
  *row = x;
}

}  // namespace RG_ISA
}  // namespace rg::math
