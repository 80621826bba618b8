// Errors on held-out recordings, in windows restarted from the measured state (docs/recordings.md).
#pragma once

#include <string>

#include "services/diagnosis/api/options.h"
#include "services/diagnosis/api/result.h"
#include "services/diagnosis/hypotheses/search_result.h"

namespace rg::diagnosis {

// Fills result->holdout and its plots; of the fitted recordings where none is held out.
void JudgeHeldOut(const recordings::RecordingSet& set, const sim::Plant& nominal, const SearchResult& search,
                  const FitData& data, const DiagnosisOptions& options, int threads, DiagnosisResult* result);

// Whether calibrated parameters alone predict held-out recordings better: by a tenth of the RMS error and
// beyond chance (one restart may decide an RMS error), or where the model is worse than the given one too.
bool WorseThanCalibrated(const HoldoutFit& h);

// With a pendulum payload that swings on over held-out recordings: why it is believed although the model with
// it predicts them no better than without. Empty where it predicts better.
std::string NoteOnFreeSwing(const HoldoutFit& h);

}  // namespace rg::diagnosis
