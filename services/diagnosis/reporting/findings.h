// From the search's result to the report: verdict, findings with confidence and class, tables.
#pragma once

#include <vector>

#include "services/diagnosis/api/result.h"
#include "services/diagnosis/hypotheses/search_result.h"
#include "services/diagnosis/likelihood/fit_setting.h"

namespace rg::diagnosis {

void Conclude(const SearchResult& search, const FitSetting& setting, DiagnosisResult* result);

// Base parameters, sorted by how far the effects found moved them, in prior standard deviations.
std::vector<LedgerRow> LedgerOf(const SearchResult& search);

// The fitted models, best first, kMostCandidates at most.
inline constexpr size_t kMostCandidates = 30;
std::vector<CandidateRow> CandidateRows(const SearchResult& search);

// By recording: the missing force of the model without effects, and the part that the found effects explain.
std::vector<ForcePlot> ForcePlots(const SearchResult& search, const FitData& data);

}  // namespace rg::diagnosis
