// What must hold after every event (the shell does not call this; tests do, after each step).
#pragma once

#include <string>
#include <vector>

#include "coordinator/core/state.h"

namespace rg::coordinator {

// One line per broken promise; empty: all hold. O(everything).
std::vector<std::string> BrokenInvariants(const State& state);

}  // namespace rg::coordinator
