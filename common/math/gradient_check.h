// Compares a Jacobian with central differences: the one check that every derivative in this project
// is tested with.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <string>

namespace rg::math {

struct GradientCheckOptions {
  // Step for input i: relative_step · max(1, |x_i|). The default balances the truncation error h²
  // against the rounding error ε/h.
  double relative_step = 6e-6;
  // Passes where |analytic - numeric| <= tolerance · scale, with
  // scale = max(scale_floor, largest |entry| of both Jacobians in that row).
  double tolerance = 1e-6;
  double scale_floor = 1.0;
  // Richardson extrapolation from h and h/2: error O(h⁴), for functions with large third derivatives.
  bool richardson = true;
};

struct GradientCheckResult {
  bool ok = false;
  double worst_error = 0.0;  // largest |analytic - numeric| / scale; NaN counts as worst
  int row = -1;              // where it is
  int column = -1;
  double analytic = 0.0;
  double numeric = 0.0;
  std::string message;  // one line for a test's output

  explicit operator bool() const { return ok; }
};

// f: m-vector of an n-vector; jacobian: m × n at x, rows are outputs.
GradientCheckResult CheckGradient(const std::function<Eigen::VectorXd(const Eigen::VectorXd&)>& f,
                                  const Eigen::VectorXd& x, const Eigen::MatrixXd& jacobian,
                                  const GradientCheckOptions& options = {});

// The numeric Jacobian itself, m × n.
Eigen::MatrixXd NumericJacobian(const std::function<Eigen::VectorXd(const Eigen::VectorXd&)>& f,
                                const Eigen::VectorXd& x, const GradientCheckOptions& options = {});

}  // namespace rg::math
