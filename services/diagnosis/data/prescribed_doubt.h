// Uncertainty of the motion of prescribed joints, as noise of the other joints' residuals that is correlated
// over a window:
//
//   residual = ν + S·c,   ν: the sensors', white;   c ~ N(0, 1): one for each way in which a joint may differ
//
// S by the model as given, along the recorded motion, from node to node as in lifted_fit.h.
#pragma once

#include "common/sim/plant.h"
#include "services/diagnosis/data/fit_data.h"

namespace rg::diagnosis {

// Fills the doubts and factors of all windows (motion.h); nothing where no joint is prescribed, or in a
// window that the plant cannot simulate.
void AddPrescribedDoubt(const sim::Plant& plant, int threads, FitData* data);

}  // namespace rg::diagnosis
