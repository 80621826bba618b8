// What is worth a trial in the simulator, after a screen: the best hypotheses, sets of joints and pairs of
// effects, what they are easily taken for, and what no linear screen can see.
#pragma once

#include <functional>
#include <vector>

#include "services/diagnosis/candidate.h"
#include "services/diagnosis/screening.h"

namespace rg::diagnosis {

// Effects to add to a model, with start values.
using TrialSpecs = std::vector<effects::EffectSpec>;

// `wanted`: hypotheses that the screen gives less are left out; above 1 also what it cannot see.
// `force`: the missing force of `from`, asked for only where it is needed.
std::vector<TrialSpecs> Trials(const FitData& data, const sim::Plant& nominal, const MotionScales& scales,
                               const Candidate& from, const ScreenResult& screened, double wanted,
                               const std::function<MissingForce()>& force);

}  // namespace rg::diagnosis
