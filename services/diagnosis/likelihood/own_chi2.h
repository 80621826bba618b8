// Parametric bootstrap of a model's χ²: its value if the model were true, the null of the verdict.
#pragma once

#include "common/base/rng.h"
#include "services/diagnosis/likelihood/lifted_fit.h"

namespace rg::diagnosis {

// χ² (as FitResult::chi2) on recordings simulated by the fitted model with another step rule (semi-implicit
// Euler at 0.2 ms, as StepRuleResiduals) and the sensors' noise, plus the 99 % quantile of the
// discontinuities of a true swinging mass (jumps.h). Only the windows' starts are refitted; parameters would
// absorb part of the step rule, so the value is rather too large.
double OwnChi2(const FitData& data, const FitModel& model, const NodeStates& states,
               const LiftedOptions& options, Rng rng);

}  // namespace rg::diagnosis
