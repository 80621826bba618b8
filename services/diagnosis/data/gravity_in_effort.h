// Whether the effort in the files includes the torque against gravity, or the drive compensates gravity
// itself and leaves that torque out.
//
// Per joint that gravity loads, the effort is explained by least squares with the worst tenth left out:
//   u = g·(M a + c(q, v)        + J·a) + d·v + k·sign(v)      gravity is left to the drive
//   u = g·(M a + c(q, v) + G(q) + J·a) + d·v + k·sign(v)      the effort carries it
// with friction d, k ≥ 0, a rotor 0 ≤ J ≤ 3·M_jj and a gain g ≥ 0.4 that drives have, so that neither
// ordinary friction and rotors nor another gain decides. The better one must leave little of gravity's
// torque, a third of what the other leaves, and less than friction alone (g = 0) does. Where motion is so
// slow that friction alone explains, gravity is left to the drive if no gain, however small, finds it in the
// effort. Where friction is as large as gravity's torque, gravity is regressed together with motion, rotor
// and friction. It is left to the drive if its coefficient is below 0.4 of the motion's gain on one joint, by
// 4 standard deviations (jackknife), and above it so on none. The other terms must explain two
// thirds of that joint's effort. Else undecided:
// gravity may be weak, masses may be wrong, or gravity may pull another way.
#pragma once

#include <string>
#include <vector>

#include "services/diagnosis/data/motion_survey.h"

namespace rg::diagnosis {

enum class GravitySide { kUnclear, kInEffort, kInDrive };

struct GravityEvidence {
  GravitySide side = GravitySide::kUnclear;
  std::vector<int> joints;       // that gravity loads
  double with = 0, without = 0;  // RMS that either leaves of their efforts, in units of gravity's torque
};

GravityEvidence WeighGravity(const MotionSurvey& survey, const sim::Plant& plant);

// One line where the files contradict `excludes`, the manifest's value or the default; else empty.
std::string GravityContradiction(const GravityEvidence& evidence, bool excludes,
                                 const std::vector<std::string>& joint_names);

}  // namespace rg::diagnosis
