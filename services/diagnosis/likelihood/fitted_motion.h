// Recorded motions as a fitted model makes them, without the sensors' noise.
#pragma once

#include <vector>

#include "services/diagnosis/likelihood/lifted_fit.h"

namespace rg::diagnosis {

// Where the joints were in the windows, each simulated from its start in `states`, on the fine grid of the
// recorded motions; these where no window is, on prescribed joints, and where a simulation fails. Efforts are
// those recorded. Accelerations are means over an interval of the grid, or of what the window has of it.
std::vector<FineMotion> FittedMotions(const FitData& data, const FitModel& model, const NodeStates& states,
                                      const LiftedOptions& options);

}  // namespace rg::diagnosis
