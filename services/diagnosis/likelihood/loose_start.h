// What is known of a window's start beside its rows: bodies that effects add (a mount, a swinging mass) are
// about where the record carries them. In directions in which nothing pushes them, as across the plane of a
// planar arm, the rows show them to second order only, and a start that follows the noise there is thrown.
#pragma once

#include "services/diagnosis/likelihood/lifted_fit.h"

namespace rg::diagnosis {

struct LooseStart {
  Eigen::VectorXd middle;     // nx: where it is carried
  Eigen::VectorXd precision;  // nx: zero for what only rows say
};

// Of every window. Ten times the root mean square that a state has along all windows is one stddev.
std::vector<LooseStart> LooseStarts(const sim::Plant& plant, const NodeStates& carried);

}  // namespace rg::diagnosis
