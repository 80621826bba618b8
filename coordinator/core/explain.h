// Why does this task not run? For people.
#pragma once

#include <string>
#include <vector>

#include "coordinator/core/state.h"

namespace rg::coordinator {

struct Explanation {
  std::vector<std::string> reasons;  // the decisive one first
  bool placeable = true;             // some connected worker could run it, now or when it is free
};

// `index` must be a task of the job.
Explanation Explain(const State& state, const Job& job, uint32_t index);

// Why nothing of a job runs, if its first ready task waits for workers that say they can run nothing for now, or what
// runs says that it waits: one line for listings. Else empty.
std::string WhyItWaits(const State& state, const Job& job);

}  // namespace rg::coordinator
