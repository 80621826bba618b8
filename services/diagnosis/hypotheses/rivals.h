// Models that explain the recordings about as well as the best one.
#pragma once

#include <string>
#include <vector>

#include "services/diagnosis/hypotheses/search_result.h"

namespace rg::diagnosis {

// Nats by which a rival must lie behind to be told apart.
inline constexpr double kSeparable = 3.0;

// A fitted model that differs from the best one by one kind of effect, exchanged for `effect`.
struct Rival {
  std::string effect;
  const Candidate* candidate = nullptr;
};
// What was tried in the place of effect `id` of the best model, best first; one per kind, the best four.
inline constexpr size_t kMostRivals = 4;
std::vector<Rival> RivalsOf(const SearchResult& search, const std::string& id);

}  // namespace rg::diagnosis
