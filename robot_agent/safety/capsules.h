// Parts of the arm as capsules (a segment in a link's frame, with a radius), and which of them have to stay
// apart.
#pragma once

#include <Eigen/Core>
#include <string>
#include <utility>
#include <vector>

namespace rg::robot_agent {

struct Capsule {
  std::string name, link;
  Eigen::Vector3d from, to;  // m, in the link's frame
  double radius = 0.0;       // m, > 0
};

struct CapsuleSet {
  std::vector<Capsule> capsules;
  std::vector<std::pair<int, int>> apart;  // indices of `capsules`
};

// Between the segments a0-a1 and b0-b1; either may be a point. NaN in, NaN out.
double SegmentDistance(const Eigen::Vector3d& a0, const Eigen::Vector3d& a1, const Eigen::Vector3d& b0,
                       const Eigen::Vector3d& b1);

}  // namespace rg::robot_agent
