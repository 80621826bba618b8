// Lanes' operations behind function pointers, so that one test sees every instruction set.
#pragma once

#include "common/math/isa.h"

namespace rg::math {

struct IsaProbe {
  int lanes;
  // out: 8 rows of 8: a+b, a-b, a*b, a/b, sqrt b, |a|, min, max; `lanes` entries each are written.
  void (*arithmetic)(const double* a, const double* b, double* out);
  void (*sincos)(const double* x, double* s, double* c);
  void (*exp)(const double* x, double* out);
};

const IsaProbe& GetProbe(Isa isa);

}  // namespace rg::math
