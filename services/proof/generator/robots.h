// The robots that a blind examination is about: chains whose lengths, masses and inertias are drawn anew
// for each case, and the Mico² of the robots' folder.
#pragma once

#include <string>
#include <vector>

#include "common/base/rng.h"
#include "common/base/status.h"

namespace rg::proof {

// "mico2", "arm7", "arm4", "scara" (two upright axes and a lift), "arm2", "pendulum", "slide".
const std::vector<std::string>& KnownRobots();

// URDF of a robot of this kind, or an "arm6", which only ordinary robots are. mico2 is read from `folder` and
// every second time has other masses and inertias; all others are drawn. Error: an unknown name, a file that
// is not there.
Result<std::string> DrawRobot(const std::string& kind, const std::string& folder, Rng rng);

// Whether EFFECTS' definition of `effect` says anything on a robot of this kind (a level slide meets no
// surface, and its sensor's zero changes nothing).
bool Applies(const std::string& effect, const std::string& kind);

// Whether two effects that act together can be told apart there at all: two levels of dry friction on one
// joint are one level.
bool CanPair(const std::string& a, const std::string& b, const std::string& kind);

}  // namespace rg::proof
