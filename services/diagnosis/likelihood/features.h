// Candidate forces as functions of the recorded motion: what an effect would do, per unit of its strength,
// to first order. Smooth effects need one, others one per value of a grid (`shape`).
#pragma once

#include <vector>

#include "common/effects/inference.h"
#include "services/diagnosis/likelihood/lifted_fit.h"

namespace rg::diagnosis {

struct Feature {
  effects::Regressor regressor;
  int joint = 0;     // where the force acts
  int other = -1;    // whose effort it is, where it is another joint's
  double shape = 0;  // grid value: a speed, a delay, a limit, cycles per revolution, …
  double scale = 1;  // coefficient of one unit of prior: coefficient = scale · standardised one
};

// Typical sizes of a set of recordings, n each.
struct MotionScales {
  Eigen::VectorXd torque;  // RMS of the drive torque about its mean, plus a third of the mean's size; without
                           // a drive, RMS of what its inertia needs
  Eigen::VectorXd speed;   // RMS
  Eigen::VectorXd acceleration;  // RMS
  Eigen::VectorXd top_speed;
  Eigen::VectorXd low, high;    // range of positions
  Eigen::VectorXd inertia;      // diag M at the middle of the motion
  Eigen::VectorXd speed_noise;  // of the smoothed velocity
  std::vector<char> still;      // never moved by more than its noise: nothing is said of it
  double duration = 1;          // longest recording, s
};
MotionScales ScalesOf(const FitData& data, const sim::Plant& plant);

struct FeatureSet {
  std::vector<Feature> features;
  FeatureBlock block;  // standardised: a coefficient of 1 is one prior stddev
};
// Of effects that the joints of `plant` take.
FeatureSet MakeFeatures(const FitData& data, const sim::Plant& plant, const MotionScales& scales);

}  // namespace rg::diagnosis
