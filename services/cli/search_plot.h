// The search of an identification (`identification.search` of an iteration's result) as plots: what hops cost
// and what was accepted over the seconds that each chain had searched, all chains together.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "services/report/page.h"

namespace rg::cli {

// One for each cost that was searched on, since costs of different functions do not compare: that of the
// windows, then, where the last round had it, that of the windows and the whole recording.
std::vector<report::Plot> SearchPlots(const nlohmann::json& identification);

// The least cost so far on the last of them, as a staircase.
report::Series LeastCost(const nlohmann::json& identification, const std::string& name);

}  // namespace rg::cli
