// Rivals of a finding: models in which another kind of effect takes its place.
#pragma once

#include <string>
#include <vector>

#include "services/diagnosis/hypotheses/search_result.h"

namespace rg::diagnosis {

// Nats by which a rival must be less likely to be excluded from a finding's class.
inline constexpr double kSeparable = 3.0;

// A fitted model that has `effect` in the place of one kind of effect of the best model.
struct Rival {
  std::string effect;
  const Candidate* candidate = nullptr;
};
// The rivals of effect `id` of the best model among the fitted models: one per kind of effect, best first.
inline constexpr size_t kMostRivals = 4;
std::vector<Rival> RivalsOf(const SearchResult& search, const std::string& id);

}  // namespace rg::diagnosis
