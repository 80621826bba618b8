// Residual functions with known optima, for the tests of solvers and searches.
#pragma once

#include <cmath>
#include <functional>

#include "services/sysid/least_squares.h"

namespace rg::sysid::testing {

// A residual function from a lambda (p, r, J or null).
class LambdaResiduals final : public ResidualFunction {
 public:
  using Fn = std::function<bool(const Eigen::VectorXd&, const StopCondition&, Eigen::VectorXd*, RowMatrix*)>;
  LambdaResiduals(int parameters, int residuals, Fn fn)
      : parameters_(parameters), residuals_(residuals), fn_(std::move(fn)) {}
  int num_parameters() const override { return parameters_; }
  int num_residuals() const override { return residuals_; }
  bool Evaluate(const Eigen::VectorXd& p, const StopCondition& stop, Eigen::VectorXd* r,
                RowMatrix* J) override {
    return fn_(p, stop, r, J);
  }

 private:
  int parameters_, residuals_;
  Fn fn_;
};

// r = A p − b.
inline LambdaResiduals Linear(const Eigen::MatrixXd& A, const Eigen::VectorXd& b) {
  return {static_cast<int>(A.cols()), static_cast<int>(A.rows()),
          [A, b](const Eigen::VectorXd& p, const StopCondition&, Eigen::VectorXd* r, RowMatrix* J) {
            *r = A * p - b;
            if (J != nullptr) *J = A;
            return true;
          }};
}

inline LambdaResiduals Rosenbrock() {
  return {2, 2, [](const Eigen::VectorXd& p, const StopCondition&, Eigen::VectorXd* r, RowMatrix* J) {
            *r << 10.0 * (p[1] - p[0] * p[0]), 1.0 - p[0];
            if (J != nullptr) *J << -20.0 * p[0], 10.0, -1.0, 0.0;
            return true;
          }};
}

// Rastrigin's function per coordinate as squares: p² + 10 (1 − cos 2πp) = p² + (√20 sin πp)².
// Local minima near every integer, the global one at 0.
inline LambdaResiduals Rastrigin(int n) {
  return {n, 2 * n, [n](const Eigen::VectorXd& p, const StopCondition&, Eigen::VectorXd* r, RowMatrix* J) {
            if (J != nullptr) J->setZero();
            for (int i = 0; i < n; ++i) {
              (*r)[2 * i] = p[i];
              (*r)[2 * i + 1] = std::sqrt(20.0) * std::sin(M_PI * p[i]);
              if (J == nullptr) continue;
              (*J)(2 * i, i) = 1.0;
              (*J)(2 * i + 1, i) = std::sqrt(20.0) * M_PI * std::cos(M_PI * p[i]);
            }
            return true;
          }};
}

// No regulariser, no bounds, unit scale, search in ±range.
inline LeastSquaresProblem FreeProblem(ResidualFunction* residuals, const Eigen::VectorXd& initial,
                                       double range = 5.0) {
  const int n = residuals->num_parameters();
  const Eigen::VectorXd ones = Eigen::VectorXd::Ones(n);
  return {residuals, initial, -1e300 * ones, 1e300 * ones, 0.0 * ones, ones, -range * ones, range * ones};
}

}  // namespace rg::sysid::testing
