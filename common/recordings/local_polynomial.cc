#include "common/recordings/local_polynomial.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "common/base/check.h"

namespace rg::recordings {

LocalPolynomial FitLocalPolynomial(const Eigen::VectorXd& t, int first, int last, double t_at, int degree) {
  RG_CHECK(first >= 0 && first <= last && last < t.size()) << "rows " << first << " to " << last;
  const int count = last - first + 1;
  const int terms = std::min(degree + 1, count);
  const double scale = std::max({std::abs(t[first] - t_at), std::abs(t[last] - t_at), 1e-12});
  Eigen::MatrixXd basis(count, terms);
  for (int i = 0; i < count; ++i) {
    const double s = (t[first + i] - t_at) / scale;
    basis(i, 0) = 1.0;
    for (int p = 1; p < terms; ++p) basis(i, p) = basis(i, p - 1) * s;
  }
  const Eigen::MatrixXd moments = basis.transpose() * basis;
  Eigen::MatrixXd wanted = Eigen::MatrixXd::Zero(terms, 2);
  wanted(0, 0) = 1.0;
  if (terms > 1) wanted(1, 1) = 1.0 / scale;
  const Eigen::MatrixXd weights = basis * moments.ldlt().solve(wanted);
  return {weights.col(0), weights.col(1)};
}

}  // namespace rg::recordings
