// Instruction sets that kernels are compiled for.
//
// Kernel headers define everything inside `inline namespace RG_ISA`, so that one program can hold the
// same template compiled for plain x86-64 (isa_v1), x86-64-v3 (AVX2 and FMA, isa_v3) and x86-64-v4
// (AVX-512, isa_v4) without breaking the one-definition rule. A unit gets its name from its compiler
// flags; rg_isa_sources() in cmake/RealityGradIsa.cmake builds a file for all three. What crosses
// between units is plain data and function pointers. Results agree to rounding between instruction
// sets, and bit for bit on one.
#pragma once

#if defined(__AVX512F__) && defined(__AVX512DQ__) && defined(__AVX512VL__)
#define RG_ISA isa_v4
#define RG_ISA_LANES 8
#elif defined(__AVX2__) && defined(__FMA__)
#define RG_ISA isa_v3
#define RG_ISA_LANES 4
#else
#define RG_ISA isa_v1
#define RG_ISA_LANES 2
#endif

// Kernels are one function after inlining; sanitizers would instrument it for minutes, so there the
// compiler decides.
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define RG_INLINE inline
#define RG_LAMBDA_INLINE
#else
#define RG_INLINE inline __attribute__((always_inline))
// After a lambda's parameter list: inlined into the kernel that calls it.
#define RG_LAMBDA_INLINE __attribute__((always_inline))
#endif

namespace rg::math {

enum class Isa { kV1 = 0, kV3 = 1, kV4 = 2 };

// The best set that this processor has. RG_ISA=v1|v3|v4 in the environment lowers it (for tests and
// for bit-for-bit repeats on a mixed cluster).
Isa DetectIsa();
const char* IsaName(Isa isa);
bool IsaSupported(Isa isa);

inline namespace RG_ISA {
// doubles in one SIMD register
inline constexpr int kNativeLanes = RG_ISA_LANES;
}  // namespace RG_ISA

}  // namespace rg::math
