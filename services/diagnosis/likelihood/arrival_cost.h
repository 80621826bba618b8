// Arrival cost of a window: a prior on the start of the bodies that effects add (a mount, a swinging mass),
// about where a simulation along the recorded motion leaves them. In directions without excitation, as across
// the plane of a planar arm, rows inform them to second order only, and a start that fits the noise diverges.
#pragma once

#include "services/diagnosis/likelihood/lifted_fit.h"

namespace rg::diagnosis {

struct ArrivalCost {
  VectorXd middle;     // nx: mean
  VectorXd precision;  // nx: zero for states that only the rows inform
};

// Of every window. The stddev of a state is ten times its RMS along all windows.
std::vector<ArrivalCost> ArrivalCosts(const sim::Plant& plant, const NodeStates& carried);

}  // namespace rg::diagnosis
