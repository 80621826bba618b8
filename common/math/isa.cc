#include "common/math/isa.h"

#include <cstdlib>
#include <string_view>

namespace rg::math {

const char* IsaName(Isa isa) {
  switch (isa) {
    case Isa::kV1:
      return "v1";
    case Isa::kV3:
      return "v3";
    case Isa::kV4:
      return "v4";
  }
  return "?";
}

bool IsaSupported(Isa isa) {
  const bool v3 =
      __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2");
  const bool v4 = v3 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
                  __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512bw") &&
                  __builtin_cpu_supports("avx512cd");
  return isa == Isa::kV1 || (isa == Isa::kV3 && v3) || (isa == Isa::kV4 && v4);
}

Isa DetectIsa() {
  static const Isa detected = [] {
    const char* text = std::getenv("RG_ISA");
    const std::string_view wanted = text == nullptr ? "v4" : text;
    for (Isa isa : {Isa::kV4, Isa::kV3}) {
      if (wanted >= IsaName(isa) && IsaSupported(isa)) return isa;
    }
    return Isa::kV1;
  }();
  return detected;
}

}  // namespace rg::math
