// A mass that swings on a rod (sloshing_payload, form "rod") is hardly damped: where it is at a window's
// start the windows before say, back to where it hung. No step of a fit leads there from anywhere else.
#pragma once

#include <vector>

#include "services/diagnosis/lifted_fit.h"

namespace rg::diagnosis {

bool HasRod(const std::vector<effects::EffectSpec>& specs);
bool HasMassInSprings(const std::vector<effects::EffectSpec>& specs);
// Whether one swings on the last link, not on the end effector.
bool SwingsOnLastLink(const std::vector<effects::EffectSpec>& specs);

// States of all windows, one after another: each starts as the end of the one before leaves it, or as it is
// in `now`, whichever is nearer to the record, and is fitted alone, at the model's values. `work`: its cost
// is added.
NodeStates FollowedStates(const FitData& data, const FitModel& model, const LiftedOptions& options,
                          NodeStates now, double* work, std::vector<double>* chi2 = nullptr);

// Fits from there, and follows again with what was found while windows stay behind, up to so many times.
FitResult FitFollowed(const FitData& data, FitModel model, const LiftedOptions& options, int rounds);

// A mass on a rod in the place of one in springs, from what is found of that: where its link hardly turns
// springs of k are a rod of L = m·9.81/k. Its hinge is the axis of the link that gravity is least along, or
// the next one, or the last.
std::vector<effects::EffectSpec> RodStarts(const FitData& data, const sim::Plant& nominal,
                                           const effects::EffectSpec& springs);

}  // namespace rg::diagnosis
