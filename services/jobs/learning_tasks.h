// Task kinds `trajectories`, `train`, `aggregate` and `examine`.
#pragma once

#include "common/base/status.h"
#include "worker/task_registry.h"

namespace rg::jobs {

// A shard of a seed range. Summary: solved, failed, failures by reason, seconds.
Result<worker::TaskOutputs> RunTrajectories(const worker::TaskInput& input, worker::TaskContext& context);

// Regresses a policy on all shards. Summary: points, losses, curve, seconds.
Result<worker::TaskOutputs> RunTrain(const worker::TaskInput& input, worker::TaskContext& context);

// What the expert would do where the policy goes, as a shard. Summary: as RunTrajectories, `failed` counting
// loops that ended early, and the quantiles of the policy's goal error.
Result<worker::TaskOutputs> RunAggregate(const worker::TaskInput& input, worker::TaskContext& context);

// Goal errors of the policy beside MPC's, in closed loop on the model. Summary and artefact: pairs, medians
// and 90 % quantiles [rad or m], null where they are not finite.
Result<worker::TaskOutputs> RunExamine(const worker::TaskInput& input, worker::TaskContext& context);

}  // namespace rg::jobs
