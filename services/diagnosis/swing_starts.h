// A mass that swings on a rod (sloshing_payload, form "rod") is hardly damped: where it is at a window's
// start the windows before say, back to where it hung. No step of a fit leads there from anywhere else.
#pragma once

#include <vector>

#include "services/diagnosis/lifted_fit.h"

namespace rg::diagnosis {

bool HasRod(const std::vector<effects::EffectSpec>& specs);
bool HasMassInSprings(const std::vector<effects::EffectSpec>& specs);

// States of all windows, one after another: each starts as the end of the one before leaves it, or as it is
// in `now`, whichever is nearer to the record, and is fitted alone, at the model's values. `work`: its cost
// is added.
NodeStates FollowedStates(const FitData& data, const FitModel& model, const LiftedOptions& options,
                          NodeStates now, double* work);

// Fits from there, and follows again with what was found while windows stay behind, up to so many times.
FitResult FitFollowed(const FitData& data, FitModel model, const LiftedOptions& options, int rounds);

}  // namespace rg::diagnosis
