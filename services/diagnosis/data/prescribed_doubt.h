// Joints that move as measured are known but for what their smoothed motion leaves open, and where they truly moved
// otherwise the others were pushed otherwise. That is noise of the others' residuals, correlated over a window:
//
//   residual = ν + S·c,   ν: the sensors', white;   c ~ N(0, 1): one for each way in which a joint may differ
//
// S by the model as given, along the recorded motion, from node to node as in lifted_fit.h.
#pragma once

#include "common/sim/plant.h"
#include "services/diagnosis/data/fit_data.h"

namespace rg::diagnosis {

// Fills the doubts and factors of all windows (motion.h); nothing where no joint is prescribed, or in a window that
// the plant cannot simulate.
void AddPrescribedDoubt(const sim::Plant& plant, int threads, FitData* data);

}  // namespace rg::diagnosis
