// The motion of joints that move as they are told, as a smooth function of time: quintic pieces between knots
// at which position, velocity and acceleration are given, so that the acceleration is continuous. Before the
// first knot and after the last one it goes on at the velocity there.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "common/base/status.h"

namespace rg::sim {

// k with times[k] <= t < times[k+1], clipped to the rows. `times`: strictly increasing, at least one.
int SegmentAt(const std::vector<double>& times, double t);

class GivenMotion {
 public:
  struct Point {
    double q = 0, v = 0;
  };

  // joints: m joints of a plant, ascending; times: K ≥ 1, strictly increasing, s; q, v, a: m × K. Refuses
  // anything not finite.
  static Result<GivenMotion> Create(std::vector<int> joints, std::vector<double> times, Eigen::MatrixXd q,
                                    Eigen::MatrixXd v, Eigen::MatrixXd a);

  const std::vector<int>& joints() const { return joints_; }
  // Of joints()[i].
  Point At(int i, double t) const;

 private:
  GivenMotion() = default;
  std::vector<int> joints_;
  std::vector<double> times_;
  Eigen::MatrixXd q_, v_, a_;
};

}  // namespace rg::sim
