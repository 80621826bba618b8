// Fits of a mass that swings on a rod from far off. Hardly damped, it is at a window's start where the
// windows before leave it, back to where it hung, and over whole windows no step of a fit leads to a length
// that is not near: over short pieces of them one does.
#pragma once

#include <optional>
#include <vector>

#include "services/diagnosis/likelihood/lifted_fit.h"

namespace rg::diagnosis {

// The state at `to` of a window that is simulated from `from`, its first; nothing where that fails.
std::optional<VectorXd> SimulatedTo(double to, const FitData& data, sim::Simulator& simulator,
                                    const NodeWindow& window, const VectorXd& from);

// States of all windows, one after another: each starts as the end of the one before leaves it, or as it is
// in `now`, or, where no such fit meets the record and `anew`, in one of the three nearest of SwingsFrom
// and LetGo, whichever comes nearest to the record, and is fitted alone, at the model's values. `work`: its
// cost is added. `chi2`: of each window there, infinite where it has no fit.
NodeStates FollowedStates(const FitData& data, const FitModel& model, const LiftedOptions& options,
                          NodeStates now, bool anew, double* work, std::vector<double>* chi2 = nullptr);

// A fit whose windows are followed: over pieces of them that grow, then to those that are met best, then to
// all; so many rounds at most while windows stay behind. The one of most evidence.
FitResult FitFollowed(const FitData& data, FitModel model, const LiftedOptions& options, int rounds);

}  // namespace rg::diagnosis
