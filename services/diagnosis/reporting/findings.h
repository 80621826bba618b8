// From the search's result to the report: verdict, findings with confidence and class, tables.
#pragma once

#include "services/diagnosis/api/result.h"
#include "services/diagnosis/hypotheses/search_result.h"
#include "services/diagnosis/likelihood/fit_setting.h"

namespace rg::diagnosis {

void Conclude(const SearchResult& search, const FitSetting& setting, DiagnosisResult* result);

}  // namespace rg::diagnosis
