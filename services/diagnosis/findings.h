// From fitted candidates to what is said: verdict, findings, confidence, classes, places, ledger.
#pragma once

#include "services/diagnosis/search.h"

namespace rg::diagnosis {

// Lines on the data themselves: joints that never moved, a rate too low for an effect, suspected signs.
std::vector<std::string> NotesOn(const recordings::RecordingSet& set, const FitData& data,
                                 const sim::Plant& nominal, const MotionScales& scales);

void Conclude(const SearchResult& search, const FitData& data, const sim::Plant& nominal,
              const MotionScales& scales, DiagnosisResult* result);

}  // namespace rg::diagnosis
