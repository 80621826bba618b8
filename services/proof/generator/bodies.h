// A URDF as DART's rigid bodies.
#pragma once

#include <Eigen/Core>
#include <dart/dynamics/Skeleton.hpp>
#include <string>
#include <vector>

#include "common/base/status.h"

namespace rg::proof {

// On a fixed base, fingers locked at 0, gravity downwards. Error: DART cannot read it.
Result<dart::dynamics::SkeletonPtr> ParseBodies(const std::string& urdf);

// Whether a robot is where nobody would go on recording it: beyond a limit by more than 15 % of the range,
// more than three turns from `home` on a joint without limits, or at four times its speed limit. n each.
bool BeyondStops(const dart::dynamics::SkeletonPtr& bodies, const std::vector<std::string>& joints,
                 const Eigen::VectorXd& home, const Eigen::VectorXd& q, const Eigen::VectorXd& v);

}  // namespace rg::proof
