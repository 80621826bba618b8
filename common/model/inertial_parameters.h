// Physically consistent inertial parameters: every θ in R¹⁰ is a body that could be built.
//
//   J = [ Σ  h ] = U Uᵀ,   U = e^α [ e^d1  s12  s13  t1 ]
//       [ hᵀ m ]                   [  0   e^d2  s23  t2 ]
//                                  [  0    0   e^d3  t3 ]
//                                  [  0    0    0    1  ]
//   θ = (α, d1, d2, d3, s12, s23, s13, t1, t2, t3)
//
// J is the pseudo-inertia of the link: mass m, first moment h = m c, second moment Σ = ∫ r rᵀ dm about
// the link's origin. It is positive definite exactly for mass distributions with positive mass and
// density somewhere off every plane: mass > 0, positive principal moments, strict triangle inequality.
// Then m = e^{2α}, c = t, and the inertia about the com is tr(S) 1 - S with S = e^{2α} L Lᵀ, L the
// upper left 3×3 of U / e^α.
// Ref: Rucker, Wensing, "Smooth parameterization of rigid-body inertia", RA-L 7(2), 2022.
#pragma once

#include <optional>

#include "common/model/robot_model.h"

namespace rg::model {

using LogCholesky = Eigen::Matrix<double, 10, 1>;

// The link parameters of θ; always consistent (to overflow).
LinkParameters FromLogCholesky(const LogCholesky& theta);

// d FromLogCholesky / dθ, 10 × 10, rows as LinkParameters.
Eigen::Matrix<double, 10, 10> LogCholeskyJacobian(const LogCholesky& theta);

// The θ of a link; none if the link is not strictly consistent (no mass, a rod without thickness, an
// inertia that breaks the triangle inequality).
std::optional<LogCholesky> ToLogCholesky(const LinkParameters& link);

// Smallest eigenvalue of S / m [m²], S the second moment about the com: > 0 iff the link is strictly
// consistent; the square of its smallest radius of gyration. -inf for mass <= 0.
double ConsistencyMargin(const LinkParameters& link);

}  // namespace rg::model
