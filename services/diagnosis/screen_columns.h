// The parameters that a screen varies and what each column of them stands for.
#pragma once

#include <vector>

#include "common/effects/effect.h"
#include "common/sim/plant.h"
#include "services/diagnosis/hypotheses.h"
#include "services/diagnosis/screening.h"

namespace rg::diagnosis {

// `plant`: with sensors' offsets and delays on every joint, as probes; `held`: the effects that the model has,
// whose columns are no hypotheses. `parameters`, one per column, are written.
std::vector<ParameterColumn> ScreenColumns(const sim::Plant& plant, const MotionScales& scales,
                                           const std::vector<effects::EffectSpec>& held,
                                           std::vector<sysid::FitParameter>* parameters);

}  // namespace rg::diagnosis
