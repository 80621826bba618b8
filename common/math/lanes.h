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

  Lanes() = default;                              // not initialised, as a double
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

  LaneMask() = default;
  RG_INLINE LaneMask(bool all) : bits(typename Lanes<N>::Bits{} - static_cast<long>(all)) {}  // NOLINT
  RG_INLINE LaneMask(typename Lanes<N>::Bits b) : bits(b) {}                                  // NOLINT

  friend RG_INLINE LaneMask operator&(LaneMask a, LaneMask b) { return {a.bits & b.bits}; }
  friend RG_INLINE LaneMask operator|(LaneMask a, LaneMask b) { return {a.bits | b.bits}; }
};

// The truth value that comparing two T gives: bool for double.
template <class T>
struct MaskOf;
template <>
struct MaskOf<double> {
  using Type = bool;
};
template <int N>
struct MaskOf<Lanes<N>> {
  using Type = LaneMask<N>;
};
template <class T>
using Mask = typename MaskOf<T>::Type;

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

RG_INLINE bool And(bool a, bool b) { return a && b; }
RG_INLINE bool Or(bool a, bool b) { return a || b; }
RG_INLINE bool Not(bool a) { return !a; }
template <int N>
RG_INLINE LaneMask<N> And(LaneMask<N> a, LaneMask<N> b) {
  return a & b;
}
template <int N>
RG_INLINE LaneMask<N> Or(LaneMask<N> a, LaneMask<N> b) {
  return a | b;
}
template <int N>
RG_INLINE LaneMask<N> Not(LaneMask<N> a) {
  return {~a.bits};
}

// One bit per lane.
RG_INLINE unsigned BitsOf(bool mask) { return mask ? 1u : 0u; }
template <int N>
RG_INLINE unsigned BitsOf(LaneMask<N> mask) {
  unsigned bits = 0;
  for (int i = 0; i < N; ++i) bits |= static_cast<unsigned>(mask.bits[i] & 1) << i;
  return bits;
}
#if RG_ISA_LANES >= 2
RG_INLINE unsigned BitsOf(LaneMask<2> mask) {
  return static_cast<unsigned>(__builtin_ia32_movmskpd((Lanes<2>::Vector)mask.bits));
}
#endif
#if RG_ISA_LANES >= 4
RG_INLINE unsigned BitsOf(LaneMask<4> mask) {
  return static_cast<unsigned>(__builtin_ia32_movmskpd256((Lanes<4>::Vector)mask.bits));
}
#endif
#if RG_ISA_LANES >= 8
RG_INLINE unsigned BitsOf(LaneMask<8> mask) {
  typedef long long Wide __attribute__((vector_size(64)));
  return __builtin_ia32_cvtq2mask512((Wide)mask.bits);
}
#endif

template <int N>
RG_INLINE bool All(LaneMask<N> mask) {
  return BitsOf(mask) == (1u << N) - 1u;
}
RG_INLINE bool All(bool mask) { return mask; }
template <int N>
RG_INLINE bool Any(LaneMask<N> mask) {
  return BitsOf(mask) != 0;
}
RG_INLINE bool Any(bool mask) { return mask; }

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
