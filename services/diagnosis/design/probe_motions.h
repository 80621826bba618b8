// Motions that a robot could make to tell rival effects apart: ramps, speeds, holds, sweeps, chirps of some
// joints, the others at rest, within position, velocity and effort limits of the model.
//
// Joints move inside the range that they were recorded in, or a quarter of a radian (5 cm) about its middle
// where that is more; the others rest where they were in the recorded row nearest to the middles. So the arm
// stays among poses that it has been near; a collision is not looked for.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "common/sim/plant.h"
#include "services/diagnosis/likelihood/features.h"

namespace rg::diagnosis {

// Rows 20 ms apart, at rest at both ends.
struct ProbeMotion {
  std::string description;  // "elbow there and back at five speeds from 0.2 to 2.8 rad/s, 14 s"
  std::vector<double> t;    // K, s, from 0
  Eigen::MatrixXd q, v, a;  // n × K
};

// `joints`: those that move, model order. What the nominal model's torques would exceed is slowed down; a
// motion whose poses alone are too heavy is left out. May be empty.
std::vector<ProbeMotion> ProbeMotions(const sim::Plant& nominal, const FitData& data,
                                      const MotionScales& scales, const std::vector<int>& joints);

}  // namespace rg::diagnosis
