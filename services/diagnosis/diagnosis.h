// Says which physics a model leaves out, from recordings: checks, calibration, localisation of the missing
// force, a screen over every effect and joint, refits in the simulator, abstention (README.md).
//
// Thread-safe for different calls; runs on options.threads threads. Deterministic: same set, same options,
// same result, whatever the number of threads.
#pragma once

#include <string>

#include "common/base/clock.h"
#include "common/base/progress.h"
#include "common/base/status.h"
#include "common/recordings/recording_set.h"
#include "services/diagnosis/api/options.h"
#include "services/diagnosis/api/result.h"

namespace rg::diagnosis {

Result<DiagnosisResult> Diagnose(const recordings::RecordingSet& set, const DiagnosisOptions& options,
                                 const Clock& clock, const ProgressFn& progress = {},
                                 const CancelToken* cancel = nullptr);

// diagnosis.json, "realitygrad.diagnosis/1".
std::string DiagnosisJson(const DiagnosisResult& result);
// The proposed motion as CSV (time, position.<joint>…, velocity.<joint>…); empty where there is none.
std::string MotionCsv(const DiagnosisResult& result);
// diagnosis.json, model.json, motion.csv where a motion is proposed, and, if `page` is not empty, report.html
// into `folder`, which is made. The page is made by report::DiagnosisPage.
Status WriteDiagnosis(const std::string& folder, const DiagnosisResult& result, const std::string& page = {});

}  // namespace rg::diagnosis
