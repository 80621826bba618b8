// The rollouts that a task of a loop reads.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.h"
#include "common/recordings/recording_set.h"
#include "worker/task_registry.h"

namespace rg::jobs {

// Oldest first, without those that ended at once and those that cannot be used: a recording with an odd row takes no
// other with it.
struct ReadRollouts {
  std::vector<recordings::RecordingSet> sets;        // at least one
  std::vector<const worker::InputArtifact*> inputs;  // of each set
  std::vector<std::string> left_out;                 // those that cannot be used and why, a line each
};
using BundleLoader = Result<recordings::RecordingSet> (*)(std::string_view bytes);
// All inputs named "recording". Where none is left: why not the newest.
Result<ReadRollouts> RolloutsOf(const worker::TaskInput& input, BundleLoader load);

}  // namespace rg::jobs
