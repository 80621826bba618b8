// Rotations: hat, exponential and logarithm, and what small rotations do. Eigen types, not for kernels.
#pragma once

#include <Eigen/Core>

namespace rg::math {

// Hat(a) b = a × b.
Eigen::Matrix3d Hat(const Eigen::Vector3d& a);
// The a of Hat(a), from the antisymmetric part of A.
Eigen::Vector3d Vee(const Eigen::Matrix3d& A);

// Rotation by |w| about w (Rodrigues); exact to rounding for small w too.
Eigen::Matrix3d ExpSo3(const Eigen::Vector3d& w);
// The w with |w| <= π and ExpSo3(w) = R. At half a turn the sign of the axis is arbitrary.
Eigen::Vector3d LogSo3(const Eigen::Matrix3d& R);

// J_l with ExpSo3(w + dw) ≈ ExpSo3(J_l dw) ExpSo3(w), and its inverse (singular at |w| = 2π).
// Ref: Solà, Deray, Atchuthan, "A micro Lie theory", 2018, equations 145, 146.
Eigen::Matrix3d LeftJacobianSo3(const Eigen::Vector3d& w);
Eigen::Matrix3d LeftJacobianInverseSo3(const Eigen::Vector3d& w);

// Rz(yaw) Ry(pitch) Rx(roll), the rpy of URDF.
Eigen::Matrix3d FromRpy(const Eigen::Vector3d& rpy);
// (roll, pitch, yaw) with pitch in [-π/2, π/2]; roll is 0 at the singular pitches.
Eigen::Vector3d ToRpy(const Eigen::Matrix3d& R);

}  // namespace rg::math
