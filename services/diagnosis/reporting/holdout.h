// Judgement on recordings that were not fitted: windows restarted as RECORDINGS.md has it.
#pragma once

#include "services/diagnosis/api/options.h"
#include "services/diagnosis/api/result.h"
#include "services/diagnosis/hypotheses/search_result.h"

namespace rg::diagnosis {

void JudgeHeldOut(const recordings::RecordingSet& set, const sim::Plant& nominal, const SearchResult& search,
                  const FitData& data, const DiagnosisOptions& options, int threads, DiagnosisResult* result);

}  // namespace rg::diagnosis
