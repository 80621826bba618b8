// Start values for pushes in Cartesian space, read from the missing force: one force on one point of the last
// link moves all joints through one Jacobian.
#pragma once

#include <vector>

#include "common/effects/effect.h"
#include "services/diagnosis/likelihood/missing_force.h"

namespace rg::diagnosis {

// Surfaces that would push as the missing force says: zero off the surface and linear in the depth beyond,
// along each axis of the base frame and for each point of contact. The best `most`, one per normal and point.
std::vector<std::vector<effects::EffectSpec>> ContactStarts(const FitData& data, const sim::Plant& nominal,
                                                            const MissingForce& missing, int most);

// A constant force in a window of time, where it explains more than the same on any single joint.
std::vector<std::vector<effects::EffectSpec>> PushStarts(const FitData& data, const sim::Plant& nominal,
                                                         const MissingForce& missing);

}  // namespace rg::diagnosis
