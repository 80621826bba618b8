// What a model's own misfit would be if it were true: the null that a verdict is held against.
#pragma once

#include "common/base/rng.h"
#include "services/diagnosis/likelihood/lifted_fit.h"

namespace rg::diagnosis {

// χ² as FitResult has it, of recordings that the fitted model made itself, by another step rule
// (semi-implicit Euler at 0.2 ms, as in StepRuleResiduals) and with the sensors' noise, and to which only the
// starts of the windows were fitted again, with the most that a true mass's jumps add (jumps.h). Fresh
// parameters would take up part of the step rule: it is rather too large than too small.
double OwnChi2(const FitData& data, const FitModel& model, const NodeStates& states,
               const LiftedOptions& options, Rng rng);

}  // namespace rg::diagnosis
