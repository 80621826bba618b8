// The exponential of all lanes at once, to 1 ulp; 0 below -745, infinity above 709.78, NaN for NaN.
//
// x = n·ln 2 + r with |r| ≤ ln 2/2 (ln 2 in two parts, the first of 33 bits, so that its product with n is
// exact), exp(r) by its series to the 13th power, scaled by 2^n in two steps (subnormal results).
#pragma once

#include "common/math/lanes.h"

namespace rg::math {
inline namespace RG_ISA {

template <int N>
RG_INLINE Lanes<N> Exp(Lanes<N> x) {
  using L = Lanes<N>;
  using Vector = typename L::Vector;
  using Bits = typename L::Bits;
  const L clipped = Select(x < L(-746.0), L(-746.0), Select(x > L(710.0), L(710.0), x));
  const L magic = 0x1.8p52;
  const L shifted = clipped * L(1.44269504088896338700e+00) + magic;
  const L n = shifted - magic;
  const L r = (clipped - n * L(6.93147180369123816490e-01)) - n * L(1.90821492927058770002e-10);
  constexpr double kInverseFactorial[] = {1.0 / 6227020800, 1.0 / 479001600, 1.0 / 39916800, 1.0 / 3628800,
                                          1.0 / 362880,     1.0 / 40320,     1.0 / 5040,     1.0 / 720,
                                          1.0 / 120,        1.0 / 24,        1.0 / 6,        0.5};
  L sum = kInverseFactorial[0];
  for (int i = 1; i < 12; ++i) sum = sum * r + L(kInverseFactorial[i]);
  const L series = L(1.0) + (r + r * r * sum);
  // The nearest integer lies in the low bits of `shifted`; half of it first, then the rest.
  const Bits whole = (Bits)shifted.v - (Bits)magic.v;
  const Bits half = whole >> 1, rest = whole - half;
  const Vector first = (Vector)((half + 1023) << 52), second = (Vector)((rest + 1023) << 52);
  return series * L(first) * L(second);
}

}  // namespace RG_ISA
}  // namespace rg::math
