// Parametric bootstrap of a model's χ²: its value if the model were true, the null of the verdict.
#pragma once

#include "common/base/rng.h"
#include "services/diagnosis/likelihood/lifted_fit.h"

namespace rg::diagnosis {

// χ² (as FitResult::chi2) on recordings that the fitted model makes with the sensors' noise and another step
// rule (semi-implicit Euler at 0.2 ms, as StepRuleResiduals). A swinging mass adds the 99 % quantile of a
// true one's discontinuities (jumps.h). Only the windows' starts are refitted. Parameters would absorb part
// of the step rule, so the value is rather too large.
double OwnChi2(const FitData& data, const FitModel& model, const NodeStates& states,
               const LiftedOptions& options, Rng rng);

}  // namespace rg::diagnosis
