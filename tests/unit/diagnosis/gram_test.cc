#include "services/diagnosis/gram.h"

#include <gtest/gtest.h>

#include <cmath>
#include <tuple>

namespace rg::diagnosis {
namespace {

RowMatrixXd Filled(long rows, long columns, double phase) {
  RowMatrixXd out(rows, columns);
  for (long i = 0; i < out.size(); ++i) out.data()[i] = std::sin(phase + 0.7 * static_cast<double>(i));
  return out;
}

// Sizes below, at and beyond whole blocks and panels.
class Gram : public ::testing::TestWithParam<std::tuple<long, long, long>> {};

TEST_P(Gram, IsTheProductThatEigenMakes) {
  const auto [rows, a, b] = GetParam();
  const RowMatrixXd A = Filled(rows, a, 0.1), B = Filled(rows, b, 0.4), before = Filled(a, b, 0.9);
  RowMatrixXd G = before;
  AddTransposedProduct(A, B, 0.3, &G);
  const RowMatrixXd expected = before + 0.3 * A.transpose() * B;
  EXPECT_LT((G - expected).cwiseAbs().maxCoeff(), 1e-11);

  RowMatrixXd own = RowMatrixXd::Zero(a, a);
  AddGram(A, 0.3, &own);
  const RowMatrixXd square = 0.3 * A.transpose() * A;
  for (long i = 0; i < a; ++i) {
    for (long j = 0; j <= i; ++j) EXPECT_NEAR(own(i, j), square(i, j), 1e-11) << i << " " << j;
  }
}

INSTANTIATE_TEST_SUITE_P(Sizes, Gram,
                         ::testing::Values(std::tuple{1L, 1L, 1L}, std::tuple{24L, 4L, 12L},
                                           std::tuple{25L, 5L, 13L}, std::tuple{100L, 48L, 24L},
                                           std::tuple{61L, 37L, 60L}));

}  // namespace
}  // namespace rg::diagnosis
