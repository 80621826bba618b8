// The parameters that a screen varies and what each column of them stands for.
#pragma once

#include <string>
#include <vector>

#include "common/effects/effect.h"
#include "common/sim/plant.h"
#include "services/diagnosis/hypotheses.h"
#include "services/diagnosis/screening.h"

namespace rg::diagnosis {

// `held` with an offset and a delay of the sensor on every joint that has none.
std::vector<effects::EffectSpec> WithProbes(const std::vector<effects::EffectSpec>& held,
                                            const std::vector<std::string>& joints);

// `plant`: with sensors' offsets and delays on every joint, as probes; `held`: the effects that the model
// has, whose columns are no hypotheses. `parameters`, one per column, are written.
std::vector<ParameterColumn> ScreenColumns(const sim::Plant& plant, const MotionScales& scales,
                                           const std::vector<effects::EffectSpec>& held,
                                           std::vector<sysid::FitParameter>* parameters);

}  // namespace rg::diagnosis
