#include "common/math/exp.h"
#include "common/math/sincos.h"
#include "tests/unit/math/isa_probe.h"

namespace rg::math {
inline namespace RG_ISA {
namespace {

using L = Lanes<kNativeLanes>;

L Read(const double* from) {
  L out;
  for (int i = 0; i < kNativeLanes; ++i) out.Set(i, from[i]);
  return out;
}
void Write(L x, double* to) {
  for (int i = 0; i < kNativeLanes; ++i) to[i] = x[i];
}

void Arithmetic(const double* a_in, const double* b_in, double* out) {
  const L a = Read(a_in), b = Read(b_in);
  const L results[8] = {a + b, a - b, a * b, a / b, Sqrt(b), Abs(a), Min(a, b), Max(a, b)};
  for (int i = 0; i < 8; ++i) Write(results[i], out + 8 * i);
}

void ProbeSinCos(const double* x, double* s, double* c) {
  L sine, cosine;
  SinCos(Read(x), &sine, &cosine);
  Write(sine, s);
  Write(cosine, c);
}

void ProbeExp(const double* x, double* out) { Write(Exp(Read(x)), out); }

}  // namespace

extern const IsaProbe kIsaProbe;
const IsaProbe kIsaProbe = {kNativeLanes, Arithmetic, ProbeSinCos, ProbeExp};

}  // namespace RG_ISA
}  // namespace rg::math
