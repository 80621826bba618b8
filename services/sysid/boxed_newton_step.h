// One Newton step that stays in a box.
#pragma once

#include <Eigen/Core>

namespace rg::sysid {

// min ½ δᵀHδ + gᵀδ with low ≤ δ ≤ high, low ≤ 0 ≤ high; H: P × P, positive definite. By an active set that
// only grows: coordinates that leave the box are set on its side and the rest is solved again. Exact when
// no bound is hit; else a feasible descent step that the caller's damping guards.
Eigen::VectorXd BoxedNewtonStep(const Eigen::MatrixXd& H, const Eigen::VectorXd& g,
                                const Eigen::VectorXd& low, const Eigen::VectorXd& high);

}  // namespace rg::sysid
