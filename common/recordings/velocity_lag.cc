#include "common/recordings/velocity_lag.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

namespace rg::recordings {
namespace {

constexpr double kHalfSpan = 0.03;  // s; at least three rows to each side
constexpr int kRows = 800;

// Local cubic round `row`: slope and second derivative are weights · q.
struct Cubic {
  int first = 0, count = 0;
  Eigen::VectorXd slope, second;
};

Cubic FitCubic(const Eigen::VectorXd& t, int row) {
  const int K = static_cast<int>(t.size());
  int first = row, last = row;
  while (first > 0 && (t[row] - t[first - 1] <= kHalfSpan || row - first < 3)) --first;
  while (last + 1 < K && (t[last + 1] - t[row] <= kHalfSpan || last - row < 3)) ++last;
  const int m = last - first + 1;
  const double scale = std::max(t[row] - t[first], t[last] - t[row]);
  Eigen::MatrixXd V(m, 4);
  for (int i = 0; i < m; ++i) {
    const double s = (t[first + i] - t[row]) / scale;
    V.row(i) << 1.0, s, s * s, s * s * s;
  }
  const Eigen::MatrixXd solve = (V.transpose() * V).ldlt().solve(V.transpose());
  return {first, m, solve.row(1).transpose() / scale, 2.0 * solve.row(2).transpose() / (scale * scale)};
}

}  // namespace

VelocityLag EstimateVelocityLag(const Recording& r) {
  const int n = r.n(), K = r.rows();
  VelocityLag out{Eigen::VectorXd::Zero(n), Eigen::VectorXd::Zero(n), Eigen::VectorXd::Zero(n)};
  if (!r.has_velocity() || K < 30) return out;
  Eigen::VectorXd aa = out.lag, da = out.lag, dd = out.lag;
  const int stride = std::max(1, K / kRows);
  double rows = 0;
  for (int row = 3; row + 3 < K; row += stride) {
    const Cubic c = FitCubic(r.t, row);
    if (r.t[c.first + c.count - 1] - r.t[c.first] > 4.0 * std::max(kHalfSpan, 3.0 * r.SamplePeriod()))
      continue;
    const Eigen::VectorXd slope = r.q.middleCols(c.first, c.count) * c.slope;
    const Eigen::VectorXd a = r.q.middleCols(c.first, c.count) * c.second;
    const Eigen::VectorXd d = r.v.col(row) - slope;
    aa += a.cwiseAbs2(), da += d.cwiseProduct(a), dd += d.cwiseAbs2();
    ++rows;
  }
  if (rows < 10) return out;
  // Rows closer than the polynomial's span share their errors.
  const double share = std::max(1.0, 2.0 * kHalfSpan / (stride * std::max(1e-9, r.SamplePeriod())));
  for (int j = 0; j < n; ++j) {
    if (!(aa[j] > 0)) continue;
    out.lag[j] = -da[j] / aa[j];
    const double rest = std::max(0.0, dd[j] - da[j] * da[j] / aa[j]);
    out.stddev[j] = std::sqrt(rest / rows * share / aa[j]);
    if (out.lag[j] > 2.0 * out.stddev[j]) {
      out.error[j] =
          std::sqrt(std::max(0.0, out.lag[j] * out.lag[j] - out.stddev[j] * out.stddev[j]) * aa[j] / rows);
    }
  }
  return out;
}

}  // namespace rg::recordings
