// The catalogue: one row per effect of EFFECTS.md, in the order of that page. Identification,
// diagnosis, prediction, the simulated robot and the reports all read it.
#pragma once

#include <string_view>
#include <vector>

#include "common/effects/effect.h"

namespace rg::effects {

// All simulated effects (neither `none` nor `parameters_only`, which are verdicts).
const std::vector<EffectInfo>& Catalog();

// The row with this id, or nullptr.
const EffectInfo* FindEffect(std::string_view id);

}  // namespace rg::effects
