// One Newton step that stays in a box.
#pragma once

#include <Eigen/Core>

namespace rg::sysid {

//   min ½ δᵀHδ + gᵀδ,  low ≤ δ ≤ high,  low ≤ 0 ≤ high;  H: P × P, positive definite
//
// by projected Newton steps (Bertsekas, SIAM J. Control Optim. 20, 1982): coordinates that the gradient holds
// at a side stay there, the rest are solved for and clipped while the model falls. Ends at the minimum.
Eigen::VectorXd BoxedNewtonStep(const Eigen::MatrixXd& H, const Eigen::VectorXd& g,
                                const Eigen::VectorXd& low, const Eigen::VectorXd& high);

}  // namespace rg::sysid
