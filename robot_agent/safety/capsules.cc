#include "robot_agent/safety/capsules.h"

#include <algorithm>

namespace rg::robot_agent {

// Ericson, Real-Time Collision Detection, 5.1.9.
double SegmentDistance(const Eigen::Vector3d& a0, const Eigen::Vector3d& a1, const Eigen::Vector3d& b0,
                       const Eigen::Vector3d& b1) {
  constexpr double kPoint = 1e-12;  // m², a segment this short is a point
  const Eigen::Vector3d along_a = a1 - a0, along_b = b1 - b0, between = a0 - b0;
  const double aa = along_a.squaredNorm(), bb = along_b.squaredNorm(), f = along_b.dot(between);
  double s = 0.0, t = 0.0;  // the nearest points are a0 + s·along_a and b0 + t·along_b
  if (aa <= kPoint && bb > kPoint) {
    t = std::clamp(f / bb, 0.0, 1.0);
  } else if (aa > kPoint && bb <= kPoint) {
    s = std::clamp(-along_a.dot(between) / aa, 0.0, 1.0);
  } else if (aa > kPoint) {
    const double c = along_a.dot(between), ab = along_a.dot(along_b);
    const double denominator = aa * bb - ab * ab;
    if (denominator > kPoint * aa * bb) s = std::clamp((ab * f - c * bb) / denominator, 0.0, 1.0);
    t = (ab * s + f) / bb;
    if (t < 0.0) {
      t = 0.0;
      s = std::clamp(-c / aa, 0.0, 1.0);
    } else if (t > 1.0) {
      t = 1.0;
      s = std::clamp((ab - c) / aa, 0.0, 1.0);
    }
  }
  return (a0 + s * along_a - b0 - t * along_b).norm();
}

}  // namespace rg::robot_agent
