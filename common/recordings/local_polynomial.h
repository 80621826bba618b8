// Local polynomials on irregular samples: the weights that a least-squares fit puts on each sample.
#pragma once

#include <Eigen/Core>

namespace rg::recordings {

// Value and slope at time t_at of the polynomial of degree `degree` fitted to x(t[first … last]) are
// value·x and slope·x. Equal weight per sample. With fewer samples than degree + 1 the degree falls.
struct LocalPolynomial {
  Eigen::VectorXd value;  // last − first + 1
  Eigen::VectorXd slope;
};
LocalPolynomial FitLocalPolynomial(const Eigen::VectorXd& t, int first, int last, double t_at, int degree);

}  // namespace rg::recordings
