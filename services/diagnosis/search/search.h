// The search for missing effects: fits of hypotheses in the simulator, compared by log evidence.
//
//   E = −½ χ²/s² − ½ Σ((θ−θ0)/σ)² − ½ log det(1 + σHσ) + log prior(structure)
//
// s²: residual variance that remains when any force is allowed (1 when the sensors are as noisy as they
// say). Two worlds are compared throughout: base parameters exactly those of the URDF, or free with priors
// around it. What the data cannot pay for in either is not claimed.
#pragma once

#include "common/base/clock.h"
#include "common/base/progress.h"
#include "services/diagnosis/api/options.h"
#include "services/diagnosis/hypotheses/search_result.h"
#include "services/diagnosis/likelihood/fit_setting.h"

namespace rg::diagnosis {

// `nominal`: the model to start from (given_model.h). The effects that it has are part of every hypothesis
// until they are pruned or make place for others.
SearchResult SearchEffects(const FitSetting& setting, const DiagnosisOptions& options, int threads,
                           const Clock& clock, const ProgressFn& progress, const CancelToken* cancel);

}  // namespace rg::diagnosis
