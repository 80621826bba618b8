#include "common/math/gradient_check.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>

#include "common/base/check.h"

namespace rg::math {
namespace {

using Function = std::function<Eigen::VectorXd(const Eigen::VectorXd&)>;

Eigen::VectorXd CentralDifference(const Function& f, const Eigen::VectorXd& x, Eigen::Index i, double h) {
  Eigen::VectorXd low = x, high = x;
  low[i] -= h;
  high[i] += h;
  const double width = high[i] - low[i];  // what was really stepped, after rounding
  return (f(high) - f(low)) / width;
}

}  // namespace

Eigen::MatrixXd NumericJacobian(const Function& f, const Eigen::VectorXd& x,
                                const GradientCheckOptions& options) {
  Eigen::MatrixXd out(f(x).size(), x.size());
  for (Eigen::Index i = 0; i < x.size(); ++i) {
    // The extrapolated formula has less truncation error, so a wider step is better.
    const double h =
        options.relative_step * std::max(1.0, std::abs(x[i])) * (options.richardson ? 50.0 : 1.0);
    out.col(i) = CentralDifference(f, x, i, h);
    if (options.richardson) out.col(i) = (4.0 * CentralDifference(f, x, i, h / 2) - out.col(i)) / 3.0;
  }
  return out;
}

GradientCheckResult CheckGradient(const Function& f, const Eigen::VectorXd& x,
                                  const Eigen::MatrixXd& jacobian, const GradientCheckOptions& options) {
  const Eigen::MatrixXd numeric = NumericJacobian(f, x, options);
  RG_CHECK(jacobian.rows() == numeric.rows() && jacobian.cols() == numeric.cols())
      << jacobian.rows() << "x" << jacobian.cols() << " given, " << numeric.rows() << "x" << numeric.cols()
      << " expected";
  GradientCheckResult result;
  for (Eigen::Index r = 0; r < numeric.rows(); ++r) {
    const double scale = std::max(
        {options.scale_floor, jacobian.row(r).cwiseAbs().maxCoeff(), numeric.row(r).cwiseAbs().maxCoeff()});
    for (Eigen::Index c = 0; c < numeric.cols(); ++c) {
      double error = std::abs(jacobian(r, c) - numeric(r, c)) / scale;
      if (std::isnan(error)) error = std::numeric_limits<double>::infinity();
      if (result.row >= 0 && error <= result.worst_error) continue;
      result.worst_error = error;
      result.row = static_cast<int>(r);
      result.column = static_cast<int>(c);
      result.analytic = jacobian(r, c);
      result.numeric = numeric(r, c);
    }
  }
  result.ok = result.worst_error <= options.tolerance;
  std::ostringstream message;
  message << "worst relative error " << result.worst_error << " at row " << result.row << ", column "
          << result.column << ": analytic " << result.analytic << ", numeric " << result.numeric;
  result.message = message.str();
  return result;
}

}  // namespace rg::math
