// The coordinates θ in which a fit moves, and the map to the parameters p of the plant.
//
// A parameter stands for itself, with its bounds and prior, except the ten inertial parameters of a link
// when all of them are fitted: they move in a relative log-Cholesky form (after Rucker & Wensing, RA-L
// 2022) of the pseudo-inertia
//
//   P = [ Σ  h ; hᵀ  m ],  Σ = ½ tr(I_o) 1 − I_o,  h = m c     (about the link frame's origin)
//   P = U0 T(ξ) T(ξ)ᵀ U0ᵀ,  P_nominal = U0 U0ᵀ, U0 upper triangular
//   T(ξ) = e^α [ e^d1 s12 s13 t1 ; 0 e^d2 s23 t2 ; 0 0 e^d3 t3 ; 0 0 0 1 ],  ξ = (α, t, d, s12, s13, s23)
//
// so that every ξ is a body that can exist: positive mass, positive principal inertias, the triangle
// inequality. ξ = 0 is the URDF's link; ξ has no unit: 2α is the log of the mass ratio, t moves the
// centre of mass in units of the link's own spatial spread, d and s stretch and shear its mass. That makes
// one prior sensible for every link of every robot. A nominal inertia that no body can have (thin rods, the
// wrong ones) is lifted to the nearest that can, with a spread of at least kMinSpread.
#pragma once

#include <Eigen/Core>
#include <string_view>
#include <vector>

#include "common/base/status.h"

#include "services/sysid/fit_parameters.h"
#include "services/sysid/least_squares.h"

namespace rg::sysid {

inline constexpr double kMinSpread = 1e-3;  // m, standard deviation of a link's mass along any axis

// "log-cholesky" or "raw", and whether a name asks for the first.
std::string_view ParametrisationName(bool consistent);
Result<bool> ParseParametrisation(std::string_view name);

class FitSpace {
 public:
  // `consistent`: use the log-Cholesky form where it applies; else every parameter stands for itself.
  FitSpace(std::vector<FitParameter> parameters, bool consistent = true);

  int size() const { return static_cast<int>(parameters_.size()); }  // P, of θ and of p
  const std::vector<FitParameter>& parameters() const { return parameters_; }
  // All P: θ of the nominal parameters, bounds (six prior stddev for ξ) and prior stddev of θ.
  const Eigen::VectorXd& nominal() const { return nominal_; }
  const Eigen::VectorXd& lower() const { return lower_; }
  const Eigen::VectorXd& upper() const { return upper_; }
  const Eigen::VectorXd& prior_stddev() const { return prior_stddev_; }

  // What θ_i is: the parameter p_i, or of ξ above α, one of t, of d or of s.
  enum class Coordinate { kItself, kMass, kCentre, kStretch, kShear };
  Coordinate CoordinateOf(int i) const;
  bool IsItself(int i) const { return CoordinateOf(i) == Coordinate::kItself; }
  // θ, P: where a plant's values are within the bounds, and nominal where no parameter stands for itself.
  Eigen::VectorXd From(const Eigen::VectorXd& values) const;
  // θ, P, of a plant's values, whatever the bounds: the inverse of Values. A link that is no body, or thinner
  // than kMinSpread, has the θ of the nearest that is; one without mass the nominal one's.
  Eigen::VectorXd At(const Eigen::VectorXd& values) const;
  // The same coordinates with the problem's initial point, bounds and scale as nominal, bounds and prior.
  FitSpace With(const LeastSquaresProblem& problem) const;
  // p(θ), P.
  Eigen::VectorXd Parameters(const Eigen::VectorXd& theta) const;
  // The plant's table with p(θ) in place.
  Eigen::VectorXd Values(const Eigen::VectorXd& theta, Eigen::VectorXd values) const;
  // dp_dθ, P × P, block diagonal.
  Eigen::MatrixXd Jacobian(const Eigen::VectorXd& theta) const;
  // J (m × P, by p) becomes J · dp_dθ, block by block.
  void PullBack(const Eigen::VectorXd& theta, RowMatrix* J) const;

 private:
  using Block = Eigen::Matrix<double, 10, 10>;
  Block BlockJacobian(int link, const Eigen::VectorXd& theta) const;

  struct LinkBlock {
    int first = 0;       // of its ten parameters: mass, com, inertia xx yy zz xy xz yz
    Eigen::Matrix4d U0;  // upper triangular
  };
  std::vector<FitParameter> parameters_;
  std::vector<LinkBlock> links_;
  Eigen::VectorXd nominal_, lower_, upper_, prior_stddev_;
};

}  // namespace rg::sysid
