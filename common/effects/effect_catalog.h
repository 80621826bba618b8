// The catalogue: one row per effect of EFFECTS.md, in the order of that page. Identification,
// diagnosis, prediction, the simulated robot and the reports all read it.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "common/effects/effect.h"
#include "common/effects/effect_role.h"

namespace rg::effects {

// All simulated effects (neither `none` nor `parameters_only`, which are verdicts). The place of a row
// is the effect's number in effect_list.h.
const std::vector<EffectInfo>& Catalog();

// The row with this id, or nullptr.
const EffectInfo* FindEffect(std::string_view id);

// What the simulator needs to know beside the row.
struct EffectTraits {
  Role role;
  std::vector<int> phases;  // order among joint laws, Phase in joint_law.h; by its option if several
  int PhaseOf(int option) const { return phases.size() > 1 ? phases[option] : phases[0]; }
  std::vector<std::string> state_names;  // internal states per joint: "bristle"
};
const EffectTraits& TraitsOf(int kind);
// Number of the effect with this id, or -1.
int KindOf(std::string_view id);

}  // namespace rg::effects
