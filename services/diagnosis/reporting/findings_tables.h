// Tables of a diagnosis: base parameters before and after, fitted models, missing force over time.
#pragma once

#include <vector>

#include "services/diagnosis/api/result.h"
#include "services/diagnosis/hypotheses/search_result.h"

namespace rg::diagnosis {

// Base parameters, sorted by how far the effects found moved them, in prior standard deviations.
std::vector<LedgerRow> LedgerOf(const SearchResult& search);

// The fitted models, best first, kMostCandidates at most.
inline constexpr size_t kMostCandidates = 30;
std::vector<CandidateRow> CandidateRows(const SearchResult& search);

// By recording: the missing force of the model without effects, and the part that the found effects explain.
std::vector<ForcePlot> ForcePlots(const SearchResult& search, const FitData& data);

}  // namespace rg::diagnosis
