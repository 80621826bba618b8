// What it costs a mass in springs that it begins anew in each window. One that may be anywhere and
// at any speed where a window begins is a force of each window's own, and follows a limit, a contact or
// friction as well as a mass: by the law it goes on from where the window before leaves it. Each of two
// windows that meet knows the state between them to some covariance (P of the one's end, P' of the other's
// start), and a step d from one to the other adds to χ²
//
//   dᵀ (P + P')⁻¹ d
//
// which is what both together would leave more than each alone, to the first order and with the parameters as
// they are. Of a true law that is about one for each state that the windows show, more where only many
// windows together know its frequency, and nothing for those that they do not show. What else is hidden (a
// motor, a bristle, a mount) is not charged.
#pragma once

#include "services/diagnosis/lifted_fit.h"

namespace rg::diagnosis {

// `fit` of `plant` to all windows of `data` with that in its χ², in each window's that goes on from another,
// and in its evidence. `options`: as in the fit.
FitResult WithJumps(const FitData& data, const sim::Plant& plant, FitResult fit,
                    const LiftedOptions& options);

// The most that it adds to the χ² of a true mass in the mean; 0 without one.
double TrueJumps(const FitData& data, const sim::Plant& plant, double noise_scale);

}  // namespace rg::diagnosis
