// Fits of a mass on a rod whose length is far off. It is hardly damped, so its state at a window's start
// follows from all windows before. Over whole windows a fit converges to nearby lengths only; over short
// pieces it converges from far.
#pragma once

#include <optional>
#include <vector>

#include "services/diagnosis/likelihood/lifted_fit.h"

namespace rg::diagnosis {

// The state at `to` of a window that is simulated from `from`, its first; nothing where that fails.
std::optional<VectorXd> SimulatedTo(double to, const FitData& data, sim::Simulator& simulator,
                                    const NodeWindow& window, const VectorXd& from);

// States of all windows, one after another, each fitted alone at the model's values. A window starts at the
// end of the one before or as in `now`, whichever has the smaller χ². Where neither fits and `anew` is set,
// the three best of SwingsFrom and LetGo are tried. Adds its
// cost to `work`. `chi2`: of each window there, infinite where it has no fit.
NodeStates FollowedStates(const FitData& data, const FitModel& model, const LiftedOptions& options,
                          NodeStates now, bool anew, double* work, std::vector<double>* chi2 = nullptr);

// A fit with FollowedStates: over growing pieces of windows, then on the windows that fit best, then on all,
// in at most `rounds` rounds. Returns the fit with the most evidence.
FitResult FitFollowed(const FitData& data, FitModel model, const LiftedOptions& options, int rounds);

}  // namespace rg::diagnosis
