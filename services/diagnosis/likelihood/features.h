// Signatures of effects: candidate forces along a motion, per unit of an effect's strength, to
// first order. Effects with a shape have one per value of a grid (`shape`).
#pragma once

#include <map>
#include <string>
#include <vector>

#include "common/effects/inference.h"
#include "services/diagnosis/likelihood/screen.h"

namespace rg::diagnosis {

struct Feature {
  effects::Regressor regressor;
  int joint = 0;     // on which the force acts
  int other = -1;    // the joint whose effort it is proportional to, for couplings
  double shape = 0;  // grid value: a speed, a delay, a limit, cycles per revolution, …
  double scale = 1;  // coefficient of one unit of prior: coefficient = scale · standardised one
};

// A surface that the robot meets, per unit of stiffness (effects/contact.h).
struct SurfaceFeature {
  std::map<std::string, std::string> options;  // its normal, and the point that meets it
  double height = 0, scale = 1;
};

// Typical magnitudes of the recorded motion, n each.
struct MotionScales {
  VectorXd torque;        // RMS of the drive torque about its mean, plus a third of the mean's size; without
                          // a drive, RMS of what its inertia needs
  VectorXd speed;         // RMS
  VectorXd acceleration;  // RMS
  VectorXd top_speed;
  VectorXd low, high;       // range of positions
  VectorXd inertia;         // diag M at the middle of the motion
  VectorXd speed_noise;     // of the smoothed velocity
  std::vector<char> still;  // never moved by more than its noise
  double duration = 1;      // longest recording, s
};
MotionScales ScalesOf(const FitData& data, const sim::Plant& plant);

struct FeatureSet {
  std::vector<Feature> features;
  std::vector<SurfaceFeature> surfaces;  // on the whole robot
  FeatureBlock block;                    // standardised: a coefficient of 1 is one prior stddev
};
// Without surfaces.
FeatureSet OfJoints(const FeatureSet& features);

// Signatures of the effects that the joints of `plant` take, along the recorded motion: of those that show
// far from a fit.
FeatureSet MakeFeatures(const FitData& data, const sim::Plant& plant, const MotionScales& scales);
// Of all of them along the motions that a model which fits makes (fitted_motion.h). Those recorded carry the
// noise that is in the residuals too, and a column of quick motion so much of it that it takes that noise
// from them; what the model makes of the motion is independent of what it leaves.
FeatureSet MakeFeatures(const FitData& data, const sim::Plant& plant, const MotionScales& scales,
                        const std::vector<FineMotion>& motions);

}  // namespace rg::diagnosis
