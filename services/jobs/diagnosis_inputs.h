// What a diagnosis and its fits read: all recordings of one robot as one set.
#pragma once

#include "common/base/status.h"
#include "common/recordings/recording_set.h"
#include "worker/task_registry.h"

namespace rg::jobs {

// All inputs named "recording". `rollouts`: they are the rollouts of a loop, oldest first; those that ended
// at once are left out, and from three on every third is held out, never the newest.
Result<recordings::RecordingSet> SetToDiagnose(const worker::TaskInput& input, bool rollouts);

}  // namespace rg::jobs
