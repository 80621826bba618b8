#include "services/diagnosis/gram.h"

#include <algorithm>

#include "common/base/check.h"

namespace rg::diagnosis {
namespace {

constexpr int kRows = 4;      // of G in one block
constexpr int kColumns = 16;  // of G in one block
constexpr int kPanel = 64;    // rows of A and B at a time: both stay in the cache

#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && !defined(__SANITIZE_ADDRESS__) && \
    !defined(__SANITIZE_THREAD__)
#define RG_EVERY_PROCESSOR __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define RG_EVERY_PROCESSOR
#endif

// Eight doubles at any address, split by the compiler as the processor needs.
typedef double Eight __attribute__((vector_size(64), aligned(8), may_alias));

// A block of G that is whole.
RG_EVERY_PROCESSOR void Block(const double* A, long a_stride, const double* B, long b_stride, int count,
                              double s, double* G, long g_stride) {
  Eight sum0[2] = {}, sum1[2] = {}, sum2[2] = {}, sum3[2] = {};
  for (int k = 0; k < count; ++k) {
    const double* x = A + k * a_stride;
    const Eight* y = reinterpret_cast<const Eight*>(B + k * b_stride);
    const Eight y0 = y[0], y1 = y[1];
    sum0[0] += x[0] * y0, sum0[1] += x[0] * y1;
    sum1[0] += x[1] * y0, sum1[1] += x[1] * y1;
    sum2[0] += x[2] * y0, sum2[1] += x[2] * y1;
    sum3[0] += x[3] * y0, sum3[1] += x[3] * y1;
  }
  const Eight* const sums[kRows] = {sum0, sum1, sum2, sum3};
  for (int i = 0; i < kRows; ++i) {
    Eight* g = reinterpret_cast<Eight*>(G + i * g_stride);
    g[0] += s * sums[i][0], g[1] += s * sums[i][1];
  }
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
