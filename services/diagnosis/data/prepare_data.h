// Prepares a recording set for fits.
#pragma once

#include <memory>

#include "common/base/status.h"
#include "common/recordings/recording_set.h"
#include "common/sim/plant.h"
#include "services/diagnosis/api/options.h"
#include "services/diagnosis/data/fit_data.h"

namespace rg::diagnosis {

// Nodes and smooth motion of the recordings to fit. Points into the set.
Result<FitData> PrepareData(const recordings::RecordingSet& set, const sim::Plant& nominal,
                            const DiagnosisOptions& options);
// The same of the held-out recordings, for FitData::held_out; null where there are none that can be
// predicted.
std::shared_ptr<const FitData> PrepareHeldOut(const recordings::RecordingSet& set, const FitData& fitted,
                                              const sim::Plant& nominal, const DiagnosisOptions& options);

}  // namespace rg::diagnosis
