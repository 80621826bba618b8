#include "services/policy/kernels.h"

namespace rg::policy {

const Kernels* KernelsBaseline() { return &internal::kBaselineTable; }

const Kernels* KernelsAvx2() {
  static const bool there = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
  return there ? &internal::kAvx2Table : nullptr;
}

const Kernels* KernelsAvx512() {
  static const bool there = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
                            __builtin_cpu_supports("avx512dq");
  return there ? &internal::kAvx512Table : nullptr;
}

const Kernels& BestKernels() {
  if (const Kernels* k = KernelsAvx512()) return *k;
  if (const Kernels* k = KernelsAvx2()) return *k;
  return *KernelsBaseline();
}

}  // namespace rg::policy
