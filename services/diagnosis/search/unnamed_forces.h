// Hypotheses with one unnamed force in addition to the given model's effects.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "services/diagnosis/search/search_state.h"

namespace rg::diagnosis {

// Variables of an unnamed force. One over speed may follow two friction laws: it comes last.
inline const std::vector<std::string> kFieldVariables = {"position", "drag", "velocity"};

// Fits one of each variable ("position": over two joints' positions where there are two), base parameters
// fixed and, if `freed`, free, until enough() is true of one.
void TryUnnamedForces(SearchState& state, bool freed, const std::function<bool(const Candidate&)>& enough);

}  // namespace rg::diagnosis
