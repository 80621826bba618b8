// Dense float32 kernels of training, compiled once per instruction set and chosen at run time.
//
// All matrices are row-major; a row of B and C holds n floats with n a multiple of kLane, so the
// kernels have no remainder along rows. Buffers need no alignment. Same instruction set, same bits:
// the order of every sum is fixed. No allocation, no state; thread-safe.
//
// This header is included by units that are compiled for newer instruction sets: it must not bring in
// any inline code.
#pragma once

#include <cstddef>

namespace rg::policy {

inline constexpr int kLane = 16;

// C[m][n] = epilogue( sum_k A(m, k) · B[k][n] ),  A(m, k) = a[m · a_row + k · a_col].
struct Gemm {
  int m, n, k;
  const float* a;
  std::ptrdiff_t a_row, a_col;
  const float* b;
  std::ptrdiff_t b_row;
  float* c;
  std::ptrdiff_t c_row;
  const float* extra;  // bias[m], or the activations behind a ReLU, laid out as C
};

enum class Epilogue {
  kNone,
  kBias,      // + extra[m]
  kBiasRelu,  // max(0, · + extra[m])
  kReluMask,  // · where extra[m][n] > 0, else 0: the derivative of the ReLU that gave extra
};

// One step of Adam (Kingma & Ba 2015, algorithm 1 with the reordered bias correction of section 2):
//   m = b1·m + (1 − b1)·g,  v = b2·v + (1 − b2)·g²,  w = decay·w − rate·m / (√v + epsilon)
struct AdamStep {
  float beta1, beta2;
  float rate;     // learning rate · √(1 − b2ᵗ) / (1 − b1ᵗ)
  float epsilon;  // epsilon · √(1 − b2ᵗ)
  float decay;    // 1 − learning rate · weight decay
};

struct Kernels {
  const char* name;
  void (*gemm)(const Gemm& g, Epilogue epilogue);
  // out[c][r] = a[r][c]; rows and cols multiples of 4.
  void (*transpose)(const float* a, std::ptrdiff_t a_row, int rows, int cols, float* out,
                    std::ptrdiff_t out_row);
  // out[r] = sum over n of a[r][n].
  void (*row_sums)(const float* a, std::ptrdiff_t a_row, int rows, int n, float* out);
  // count is a multiple of kLane.
  void (*adam)(float* w, float* m, float* v, const float* g, std::size_t count, const AdamStep& step);
};

// Null where the processor or the compiler lacks the instruction set.
const Kernels* KernelsBaseline();  // plain x86-64
const Kernels* KernelsAvx2();      // AVX2 and FMA
const Kernels* KernelsAvx512();    // AVX-512 F, VL, DQ
// The widest one there is.
const Kernels& BestKernels();

namespace internal {
extern const Kernels kBaselineTable, kAvx2Table, kAvx512Table;
}

}  // namespace rg::policy
