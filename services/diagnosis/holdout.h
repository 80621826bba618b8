// Judgement on recordings that were not fitted: windows restarted as RECORDINGS.md has it.
#pragma once

#include "services/diagnosis/search.h"

namespace rg::diagnosis {

void JudgeHeldOut(const recordings::RecordingSet& set, const sim::Plant& nominal, const SearchResult& search,
                  const FitData& data, const DiagnosisOptions& options, int threads, DiagnosisResult* result);

}  // namespace rg::diagnosis
