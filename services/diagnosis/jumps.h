// What it costs an account that its hidden states begin anew in each window. A mass that may be anywhere and
// at any speed where a window begins is a force of each window's own, and follows a limit, a contact or
// friction as well as a mass: by the law it goes on from where the window before leaves it. Each of two
// windows that meet knows the state between them to some covariance (P of the one's end, P' of the other's
// start), and a step d from one to the other adds to χ²
//
//   dᵀ (P + P')⁻¹ d
//
// which is what both together would leave more than each alone, to the first order. Of a true law that is
// about one for each hidden state that the windows show, and nothing for those that they do not.
#pragma once

#include "services/diagnosis/lifted_fit.h"

namespace rg::diagnosis {

// `fit` of `plant` to all windows of `data` with that in its χ², in each window's that goes on from another,
// and in its evidence. `options`: as in the fit.
FitResult WithJumps(const FitData& data, const sim::Plant& plant, FitResult fit,
                    const LiftedOptions& options);

}  // namespace rg::diagnosis
