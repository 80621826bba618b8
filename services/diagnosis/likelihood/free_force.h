// A force of any course in time on some joints: constant on short segments of a window, each with a prior.
#pragma once

#include <vector>

#include "services/diagnosis/likelihood/lifted_fit.h"

namespace rg::diagnosis {

struct FreeForce {
  std::vector<int> joints;
  VectorXd prior;  // n: stddev of a segment's value
  double segment_s = 0.05;
};

// Its segments in one window of N intervals, as features (screen.h): segment after segment, in each joint
// after joint.
struct ForceSegments {
  std::vector<int> joint;  // of each
  MatrixXd phi;            // segments × N
  std::vector<double> t;   // middles
};
ForceSegments SegmentsOf(const FreeForce& force, const NodeWindow& window);

}  // namespace rg::diagnosis
