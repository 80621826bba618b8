// Task kinds `trajectories` and `train`.
#pragma once

#include "common/base/status.h"
#include "worker/task_registry.h"

namespace rg::jobs {

// A shard of a seed range. Summary: solved, failed, failures by reason, seconds.
Result<worker::TaskOutputs> RunTrajectories(const worker::TaskInput& input, worker::TaskContext& context);

// Regresses a policy on all shards. Summary: points, losses, curve, seconds.
Result<worker::TaskOutputs> RunTrain(const worker::TaskInput& input, worker::TaskContext& context);

}  // namespace rg::jobs
