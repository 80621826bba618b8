#include "services/sysid/boxed_newton_step.h"

#include <Eigen/Cholesky>
#include <utility>
#include <vector>

namespace rg::sysid {

using Eigen::MatrixXd;
using Eigen::VectorXd;

VectorXd BoxedNewtonStep(const MatrixXd& H, const VectorXd& g, const VectorXd& low, const VectorXd& high) {
  const int P = static_cast<int>(g.size());
  VectorXd step = VectorXd::Zero(P);
  std::vector<int> free;
  for (int i = 0; i < P; ++i) {
    const bool pushed_out = (high[i] <= 0.0 && g[i] < 0.0) || (low[i] >= 0.0 && g[i] > 0.0);
    if (!pushed_out && low[i] < high[i]) free.push_back(i);
  }
  while (!free.empty()) {
    const int f = static_cast<int>(free.size());
    const VectorXd rhs = -(g + H * step);
    MatrixXd H_ff(f, f);
    VectorXd b(f);
    for (int a = 0; a < f; ++a) {
      b[a] = rhs[free[a]];
      for (int c = 0; c < f; ++c) H_ff(a, c) = H(free[a], free[c]);
    }
    const VectorXd x = H_ff.ldlt().solve(b);
    std::vector<int> still_free;
    for (int a = 0; a < f; ++a) {
      const int i = free[a];
      if (x[a] < low[i] || x[a] > high[i]) {
        step[i] = x[a] < low[i] ? low[i] : high[i];
      } else {
        still_free.push_back(i);
      }
    }
    if (still_free.size() == free.size()) {
      for (int a = 0; a < f; ++a) step[free[a]] = x[a];
      break;
    }
    free = std::move(still_free);
  }
  return step;
}

}  // namespace rg::sysid
