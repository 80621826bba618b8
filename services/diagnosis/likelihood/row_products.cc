#include "services/diagnosis/likelihood/row_products.h"

#include <algorithm>

#include "common/base/check.h"

namespace rg::diagnosis {
namespace {

constexpr int kRows = 4;      // of G in one block
constexpr int kColumns = 12;  // of G in one block
constexpr int kPanel = 96;    // terms of a sum at a time: both factors stay in the cache

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__) && \
    !defined(__SANITIZE_THREAD__)
#define RG_EVERY_PROCESSOR __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define RG_EVERY_PROCESSOR
#endif

// Four doubles at any address.
typedef double Four __attribute__((vector_size(32), aligned(8), may_alias));

// Element (i, k) of the left factor, i: row of G, is at [i·by_row + k·by_term].
struct Left {
  const double* data;
  long by_row, by_term;
};
// Element (k, j) of the right factor, j: column of G, is at [k·by_term + j].
struct Right {
  const double* data;
  long by_term;
};

// A block of G that is whole. Its twelve sums, four columns of B and a value of A fill the sixteen registers
// that processors without AVX-512 have; a larger block would go through memory.
RG_EVERY_PROCESSOR void Block(Left A, Right B, int count, double s, double* G, long g_stride) {
  Four s00 = {}, s01 = {}, s02 = {}, s10 = {}, s11 = {}, s12 = {};
  Four s20 = {}, s21 = {}, s22 = {}, s30 = {}, s31 = {}, s32 = {};
  const long row = A.by_row;
  for (int k = 0; k < count; ++k) {
    const double* x = A.data + k * A.by_term;
    const Four* y = reinterpret_cast<const Four*>(B.data + k * B.by_term);
    const Four y0 = y[0], y1 = y[1], y2 = y[2];
    s00 += x[0] * y0, s01 += x[0] * y1, s02 += x[0] * y2;
    s10 += x[row] * y0, s11 += x[row] * y1, s12 += x[row] * y2;
    s20 += x[2 * row] * y0, s21 += x[2 * row] * y1, s22 += x[2 * row] * y2;
    s30 += x[3 * row] * y0, s31 += x[3 * row] * y1, s32 += x[3 * row] * y2;
  }
  const auto add = [&](int i, const Four& a, const Four& b, const Four& c) {
    Four* g = reinterpret_cast<Four*>(G + i * g_stride);
    g[0] += s * a, g[1] += s * b, g[2] += s * c;
  };
  add(0, s00, s01, s02), add(1, s10, s11, s12), add(2, s20, s21, s22), add(3, s30, s31, s32);
}

// Copies of what is left at the edges, zeros beyond: they go through the same block.
Left Padded(Left A, int rows, int count, double* copy) {
  std::fill_n(copy, kRows * count, 0.0);
  for (int k = 0; k < count; ++k) {
    for (int i = 0; i < rows; ++i) copy[k * kRows + i] = A.data[i * A.by_row + k * A.by_term];
  }
  return {copy, 1, kRows};
}

Right Padded(Right B, int columns, int count, double* copy) {
  std::fill_n(copy, kColumns * count, 0.0);
  for (int k = 0; k < count; ++k) std::copy_n(B.data + k * B.by_term, columns, copy + k * kColumns);
  return {copy, kColumns};
}

// G += s·A·B over M terms; with `lower`, only blocks that touch the lower triangle.
void Add(Left A, Right B, long M, double s, bool lower, MutableRows* G) {
  const long a = G->rows(), b = G->cols(), stride = G->outerStride();
  double left[kRows * kPanel], right[kColumns * kPanel];
  for (long k = 0; k < M; k += kPanel) {
    const int count = static_cast<int>(std::min<long>(kPanel, M - k));
    for (long j = 0; j < b; j += kColumns) {
      const int columns = static_cast<int>(std::min<long>(kColumns, b - j));
      Right y{B.data + k * B.by_term + j, B.by_term};
      if (columns < kColumns) y = Padded(y, columns, count, right);
      for (long i = 0; i < a; i += kRows) {
        const int rows = static_cast<int>(std::min<long>(kRows, a - i));
        if (lower && i + rows <= j) continue;
        Left x{A.data + k * A.by_term + i * A.by_row, A.by_row, A.by_term};
        double* g = G->data() + i * stride + j;
        if (rows == kRows && columns == kColumns) {
          Block(x, y, count, s, g, stride);
          continue;
        }
        if (rows < kRows) x = Padded(x, rows, count, left);
        double sums[kRows * kColumns] = {};
        Block(x, y, count, s, sums, kColumns);
        for (int r = 0; r < rows; ++r) {
          for (int c = 0; c < columns; ++c) g[r * stride + c] += sums[r * kColumns + c];
        }
      }
    }
  }
}

}  // namespace

void AddProduct(const Rows& A, const Rows& B, double s, MutableRows G) {
  RG_CHECK(A.cols() == B.rows() && G.rows() == A.rows() && G.cols() == B.cols());
  Add({A.data(), A.outerStride(), 1}, {B.data(), B.outerStride()}, A.cols(), s, false, &G);
}

void AddTransposedProduct(const Rows& A, const Rows& B, double s, MutableRows G) {
  RG_CHECK(A.rows() == B.rows() && G.rows() == A.cols() && G.cols() == B.cols());
  Add({A.data(), 1, A.outerStride()}, {B.data(), B.outerStride()}, A.rows(), s, false, &G);
}

void AddGram(const Rows& A, double s, MutableRows G) {
  RG_CHECK(G.rows() == A.cols() && G.cols() == A.cols());
  Add({A.data(), 1, A.outerStride()}, {A.data(), A.outerStride()}, A.rows(), s, true, &G);
}

}  // namespace rg::diagnosis
