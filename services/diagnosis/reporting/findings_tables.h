// What a diagnosis shows beside its findings: parameters before and after, what else was tried, the missing
// force over time.
#pragma once

#include <vector>

#include "services/diagnosis/api/result.h"
#include "services/diagnosis/hypotheses/search_result.h"

namespace rg::diagnosis {

// Of the base parameters, those first that the account moved most from where they were without it, in
// standard deviations of their priors.
std::vector<LedgerRow> LedgerOf(const SearchResult& search);

// Of the accounts that were tried, the best ones first.
inline constexpr size_t kMostCandidates = 30;
std::vector<CandidateRow> CandidateRows(const SearchResult& search);

// By recording: the force that the model without effects misses, and what of it the account explains.
std::vector<ForcePlot> ForcePlots(const SearchResult& search, const FitData& data);

}  // namespace rg::diagnosis
