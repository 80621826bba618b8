// Candidate motions for an experiment that separates effects: ramps, speeds, holds, sweeps, chirps of some
// joints, the others at rest, within position, velocity and effort limits of the model.
//
// Joints move within the recorded range, or a quarter of a radian (5 cm) about its middle where that is more;
// the others rest at the recorded row nearest to the middles, so that the arm stays near recorded poses.
// Collisions are not checked.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "services/diagnosis/likelihood/fit_setting.h"

namespace rg::diagnosis {

// Rows 20 ms apart, at rest at both ends.
struct ProbeMotion {
  std::string description;  // "elbow there and back at five speeds from 0.2 to 2.8 rad/s, 14 s"
  std::vector<double> t;    // K, s, from 0
  MatrixXd q, v, a;         // n × K
};

// `joints`: those that move, model order. Motions are slowed down until the nominal model's torques keep the
// limits; those whose poses exceed them at rest are left out. May be empty.
std::vector<ProbeMotion> ProbeMotions(const FitSetting& setting, const std::vector<int>& joints);

}  // namespace rg::diagnosis
