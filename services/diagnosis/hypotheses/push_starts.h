// Start values of pushes from outside, from the missing force: a force f at a point of the last link is Jᵀf
// on the joints.
#pragma once

#include <vector>

#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/missing_force.h"

namespace rg::diagnosis {

// A constant Cartesian force over an interval of time, if it explains more than a torque on any single joint.
std::vector<TrialSpecs> PushStarts(const FitData& data, const sim::Plant& nominal,
                                   const MissingForce& missing);

}  // namespace rg::diagnosis
