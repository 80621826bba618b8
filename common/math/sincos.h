// Sine and cosine of all lanes at once, to 1 ulp of the larger of the two for |x| < 10⁶ (an angle that
// large has wound 10⁵ times); beyond, and for infinities and NaN, the C library answers lane by lane.
//
// Reduction by n·π/2 in three parts of 33 bits (Cody & Waite), whose products with n are exact, then
// the minimax polynomials of fdlibm on [-π/4, π/4] (Sun Microsystems, 1993).
#pragma once

#include "common/math/lanes.h"

namespace rg::math {
inline namespace RG_ISA {

template <int N>
RG_INLINE void SinCos(Lanes<N> x, Lanes<N>* sine, Lanes<N>* cosine) {
  using L = Lanes<N>;
  using Vector = typename L::Vector;
  using Bits = typename L::Bits;
  // Adding 1.5·2⁵² leaves the nearest integer in the low bits of the sum.
  const L magic = 0x1.8p52;
  const L shifted = x * L(0.63661977236758138243) + magic;
  const L n = shifted - magic;
  const Bits quadrant = (Bits)shifted.v;

  const L a = x - n * L(1.57079632673412561417e+00);  // exact
  const L w = n * L(6.07710050630396597660e-11);      // exact
  const L b = a - w;
  const L r = b + (((a - b) - w) - n * L(2.02226624879595063154e-21));

  const L z = r * r;
  const L s =
      r + r * z *
              (L(-1.66666666666666324348e-01) +
               z * (L(8.33333333332248946124e-03) +
                    z * (L(-1.98412698298579493134e-04) +
                         z * (L(2.75573137070700676789e-06) +
                              z * (L(-2.50507602534068634195e-08) + z * L(1.58969099521155010221e-10))))));
  const L half = L(0.5) * z;
  const L one_minus = L(1.0) - half;
  const L c =
      one_minus +
      (((L(1.0) - one_minus) - half) +
       z * z *
           (L(4.16666666666666019037e-02) +
            z * (L(-1.38888888888741095749e-03) +
                 z * (L(2.48015872894767294178e-05) +
                      z * (L(-2.75573143513906633035e-07) +
                           z * (L(2.08757232129817482790e-09) + z * L(-1.13596475577881948265e-11)))))));

  const LaneMask<N> swap = {(quadrant & 1) != 0};
  const Bits flip_sine = (quadrant & 2) << 62;
  const Bits flip_cosine = ((quadrant + 1) & 2) << 62;
  *sine = (Vector)((Bits)Select(swap, c, s).v ^ flip_sine);
  *cosine = (Vector)((Bits)Select(swap, s, c).v ^ flip_cosine);

  const LaneMask<N> small = Abs(x) < L(1e6);
  if (!All(small)) [[unlikely]] {
    for (int i = 0; i < N; ++i) {
      if (small.bits[i]) continue;
      sine->v[i] = __builtin_sin(x.v[i]);
      cosine->v[i] = __builtin_cos(x.v[i]);
    }
  }
}

template <int N>
RG_INLINE Lanes<N> Sin(Lanes<N> x) {
  Lanes<N> sine, cosine;
  SinCos(x, &sine, &cosine);
  return sine;
}
template <int N>
RG_INLINE Lanes<N> Cos(Lanes<N> x) {
  Lanes<N> sine, cosine;
  SinCos(x, &sine, &cosine);
  return cosine;
}

}  // namespace RG_ISA
}  // namespace rg::math
