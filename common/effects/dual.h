// Forward derivatives of a scalar law by N local variables: value + gradient, fixed size, no tape.
// T is double or a pack of lanes; laws are written once over S = double, Dual<T, 1>, Dual<T, N>.
//
// Comparisons give masks on the values (bool for double); laws choose with Select(mask, a, b), never
// with `if`, so that lanes may take different branches. At a kink the derivative is that of the branch
// taken.
#pragma once

#include <cmath>

#include "common/math/exp.h"
#include "common/math/sincos.h"

namespace rg::effects {
inline namespace RG_ISA {

RG_INLINE double Select(bool mask, double a, double b) { return mask ? a : b; }
RG_INLINE double Abs(double a) { return std::fabs(a); }
RG_INLINE double Sqrt(double a) { return std::sqrt(a); }
RG_INLINE double Exp(double a) { return std::exp(a); }
RG_INLINE double Sin(double a) { return std::sin(a); }
RG_INLINE double Cos(double a) { return std::cos(a); }
RG_INLINE double Value(double a) { return a; }
using math::All;
using math::And;
using math::Not;
using math::Or;

template <class T, int N>
struct Dual {
  T v;
  T d[N];

  Dual() = default;           // not initialised, as a double
  Dual(T value) : v(value) {  // NOLINT: constants mix with duals
    ClearFrom<0>();
  }

  static Dual Variable(T value, int index) {
    Dual x(value);
    x.d[index] = T(1);
    return x;
  }

  Dual& operator+=(const Dual& b) {
    v += b.v;
    for (int i = 0; i < N; ++i) d[i] += b.d[i];
    return *this;
  }
  Dual& operator-=(const Dual& b) {
    v -= b.v;
    for (int i = 0; i < N; ++i) d[i] -= b.d[i];
    return *this;
  }
  Dual& operator*=(const Dual& b) { return *this = *this * b; }

  friend Dual operator-(const Dual& a) {
    Dual r(-a.v);
    for (int i = 0; i < N; ++i) r.d[i] = -a.d[i];
    return r;
  }
  friend Dual operator+(Dual a, const Dual& b) { return a += b; }
  friend Dual operator-(Dual a, const Dual& b) { return a -= b; }
  friend Dual operator+(Dual a, T b) {
    a.v += b;
    return a;
  }
  friend Dual operator+(T b, Dual a) { return a + b; }
  friend Dual operator-(Dual a, T b) {
    a.v -= b;
    return a;
  }
  friend Dual operator-(T b, const Dual& a) { return -a + b; }
  friend Dual operator*(const Dual& a, const Dual& b) {
    Dual r(a.v * b.v);
    for (int i = 0; i < N; ++i) r.d[i] = a.v * b.d[i] + b.v * a.d[i];
    return r;
  }
  friend Dual operator*(const Dual& a, T b) { return Chain(a, a.v * b, b); }
  friend Dual operator*(T b, const Dual& a) { return Chain(a, a.v * b, b); }
  friend Dual operator/(const Dual& a, const Dual& b) {
    const T inverse = T(1) / b.v;
    Dual r(a.v * inverse);
    for (int i = 0; i < N; ++i) r.d[i] = (a.d[i] - r.v * b.d[i]) * inverse;
    return r;
  }
  friend Dual operator/(const Dual& a, T b) { return a * (T(1) / b); }
  friend Dual operator/(T a, const Dual& b) { return Chain(b, a / b.v, -a / (b.v * b.v)); }

  friend auto operator<(const Dual& a, const Dual& b) { return a.v < b.v; }
  friend auto operator>(const Dual& a, const Dual& b) { return a.v > b.v; }
  friend auto operator<(const Dual& a, T b) { return a.v < b; }
  friend auto operator>(const Dual& a, T b) { return a.v > b; }

  // f(a) with value f and slope df.
  friend Dual Chain(const Dual& a, T f, T df) {
    Dual r(f);
    for (int i = 0; i < N; ++i) r.d[i] = df * a.d[i];
    return r;
  }

 private:
  // d[k] … = 0. Short ones by name: the compiler would make a loop a string instruction, which costs more.
  template <int k>
  RG_INLINE void ClearFrom() {
    if constexpr (N > 16) {
      for (int i = k; i < N; ++i) d[i] = T(0.0);
    } else if constexpr (k < N) {
      d[k] = T(0.0);
      ClearFrom<k + 1>();
    }
  }
};

template <class Mask, class T, int N>
Dual<T, N> Select(const Mask& mask, const Dual<T, N>& a, const Dual<T, N>& b) {
  Dual<T, N> r(Select(mask, a.v, b.v));
  for (int i = 0; i < N; ++i) r.d[i] = Select(mask, a.d[i], b.d[i]);
  return r;
}
template <class T, int N>
Dual<T, N> Abs(const Dual<T, N>& a) {
  return Chain(a, Abs(a.v), Select(a.v < T(0), T(-1), Select(a.v > T(0), T(1), T(0))));
}
// Zero with zero slope at zero.
template <class T, int N>
Dual<T, N> Sqrt(const Dual<T, N>& a) {
  const T root = Sqrt(a.v);
  return Chain(a, root, Select(root > T(0), T(0.5) / Select(root > T(0), root, T(1)), T(0)));
}
template <class T, int N>
Dual<T, N> Exp(const Dual<T, N>& a) {
  const T e = Exp(a.v);
  return Chain(a, e, e);
}
template <class T, int N>
Dual<T, N> Sin(const Dual<T, N>& a) {
  return Chain(a, Sin(a.v), Cos(a.v));
}
template <class T, int N>
Dual<T, N> Cos(const Dual<T, N>& a) {
  return Chain(a, Cos(a.v), -Sin(a.v));
}
template <class T, int N>
T Value(const Dual<T, N>& a) {
  return a.v;
}

// The scalar underneath: double for double and Dual<double, N>.
template <class S>
struct BaseOf {
  using type = S;
};
template <class T, int N>
struct BaseOf<Dual<T, N>> {
  using type = T;
};
template <class S>
using Base = typename BaseOf<S>::type;

template <class S>
S Max(const S& a, const S& b) {
  return Select(a < b, b, a);
}
template <class S>
S Min(const S& a, const S& b) {
  return Select(b < a, b, a);
}

}  // namespace RG_ISA
}  // namespace rg::effects
