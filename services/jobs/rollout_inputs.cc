#include "services/jobs/rollout_inputs.h"

#include <utility>

#include "services/jobs/kinds.h"
#include "services/rollouts/recording_bundle.h"

namespace rg::jobs {

Result<ReadRollouts> RolloutsOf(const worker::TaskInput& input, BundleLoader load) {
  RG_RETURN_IF_ERROR(input.Require(kInputRecording).status());
  ReadRollouts out;
  Status newest;
  for (const worker::InputArtifact* artifact : input.All(kInputRecording)) {
    const std::string name = "recording " + artifact->sha256.substr(0, 12);
    const Status rows = rg::rollouts::CheckRows(artifact->bytes, rg::rollouts::kLeastRows);
    if (rows.code() == StatusCode::kFailedPrecondition) {  // it ended at once
      newest = rows;
      continue;
    }
    auto set = load(artifact->bytes);
    if (!set.ok()) {
      newest = set.status().WithPrefix(name);
      out.left_out.push_back(name + " is left out: " + set.status().message());
      continue;
    }
    out.sets.push_back(std::move(*set)), out.inputs.push_back(artifact);
  }
  if (out.sets.empty()) return newest;
  return out;
}

}  // namespace rg::jobs
