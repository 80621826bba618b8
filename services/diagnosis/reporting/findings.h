// From the search's result to the report: verdict, findings with confidence and class, tables.
#pragma once

#include "services/diagnosis/api/result.h"
#include "services/diagnosis/hypotheses/search_result.h"

namespace rg::diagnosis {

void Conclude(const SearchResult& search, const FitData& data, const sim::Plant& nominal,
              const MotionScales& scales, DiagnosisResult* result);

}  // namespace rg::diagnosis
