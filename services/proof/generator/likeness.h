// How near other masses, centres of mass, inertias and damping come to what an effect does.
#pragma once

#include <string>
#include <vector>

#include "services/proof/generator/comparison.h"
#include "services/proof/generator/set_files.h"
#include "services/proof/generator/truth.h"

namespace rg::proof {

// χ² per second that the robot `without` an effect leaves of what `truth` does over the tracks when the named
// links and all joints' damping are changed so that it leaves least: Gauss-Newton on predictions over windows
// of 1 s, each with a start of its own to be found, over the sensors' `noise` (rad or m), with the
// priors of Tune and a wide one on damping. Stops early where it cannot come near the noise.
double LeftByNearestBodies(const Comparison& compared, const Truth& truth, const std::vector<Track>& tracks,
                           const Truth& without, const std::vector<std::string>& links, double noise);

}  // namespace rg::proof
