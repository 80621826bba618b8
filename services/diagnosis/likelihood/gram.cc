#include "services/diagnosis/likelihood/gram.h"

#include <algorithm>

#include "common/base/check.h"

namespace rg::diagnosis {
namespace {

constexpr int kRows = 4;      // of G in one block
constexpr int kColumns = 12;  // of G in one block
constexpr int kPanel = 24;    // rows of A and B at a time: both stay in the cache

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__) && \
    !defined(__SANITIZE_THREAD__)
#define RG_EVERY_PROCESSOR __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define RG_EVERY_PROCESSOR
#endif

// Four doubles at any address.
typedef double Four __attribute__((vector_size(32), aligned(8), may_alias));

// A block of G that is whole. Its twelve sums, a row of B and a value of A fill the sixteen registers that
// processors without AVX-512 have; a larger block would go through memory.
RG_EVERY_PROCESSOR void Block(const double* A, long a_stride, const double* B, long b_stride, int count,
                              double s, double* G, long g_stride) {
  Four s00 = {}, s01 = {}, s02 = {}, s10 = {}, s11 = {}, s12 = {};
  Four s20 = {}, s21 = {}, s22 = {}, s30 = {}, s31 = {}, s32 = {};
  for (int k = 0; k < count; ++k) {
    const double* x = A + k * a_stride;
    const Four* y = reinterpret_cast<const Four*>(B + k * b_stride);
    const Four y0 = y[0], y1 = y[1], y2 = y[2];
    s00 += x[0] * y0, s01 += x[0] * y1, s02 += x[0] * y2;
    s10 += x[1] * y0, s11 += x[1] * y1, s12 += x[1] * y2;
    s20 += x[2] * y0, s21 += x[2] * y1, s22 += x[2] * y2;
    s30 += x[3] * y0, s31 += x[3] * y1, s32 += x[3] * y2;
  }
  const auto add = [&](int row, const Four& a, const Four& b, const Four& c) {
    Four* g = reinterpret_cast<Four*>(G + row * g_stride);
    g[0] += s * a, g[1] += s * b, g[2] += s * c;
  };
  add(0, s00, s01, s02), add(1, s10, s11, s12), add(2, s20, s21, s22), add(3, s30, s31, s32);
}

void Edge(const double* A, long a_stride, const double* B, long b_stride, int count, int rows, int columns,
          double s, double* G, long g_stride) {
  for (int i = 0; i < rows; ++i) {
    for (int j = 0; j < columns; ++j) {
      double sum = 0;
      for (int k = 0; k < count; ++k) sum += A[k * a_stride + i] * B[k * b_stride + j];
      G[i * g_stride + j] += s * sum;
    }
  }
}

void Add(const RowMatrixXd& A, const RowMatrixXd& B, double s, bool lower, RowMatrixXd* G) {
  RG_CHECK(A.rows() == B.rows() && G->rows() == A.cols() && G->cols() == B.cols());
  const long M = A.rows(), a = A.cols(), b = B.cols();
  for (long k = 0; k < M; k += kPanel) {
    const int count = static_cast<int>(std::min<long>(kPanel, M - k));
    for (long j = 0; j < b; j += kColumns) {
      const int columns = static_cast<int>(std::min<long>(kColumns, b - j));
      for (long i = 0; i < a; i += kRows) {
        const int rows = static_cast<int>(std::min<long>(kRows, a - i));
        if (lower && i + rows <= j) continue;
        const double* x = A.data() + k * a + i;
        const double* y = B.data() + k * b + j;
        double* g = G->data() + i * b + j;
        if (rows == kRows && columns == kColumns) {
          Block(x, a, y, b, count, s, g, b);
        } else {
          Edge(x, a, y, b, count, rows, columns, s, g, b);
        }
      }
    }
  }
}

}  // namespace

void AddTransposedProduct(const RowMatrixXd& A, const RowMatrixXd& B, double s, RowMatrixXd* G) {
  Add(A, B, s, false, G);
}

void AddGram(const RowMatrixXd& A, double s, RowMatrixXd* G) { Add(A, A, s, true, G); }

}  // namespace rg::diagnosis
