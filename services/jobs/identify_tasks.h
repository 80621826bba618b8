// Task kinds `identify` and `conclude`.
#pragma once

#include "common/base/status.h"
#include "worker/task_registry.h"

namespace rg::jobs {

// One round of one chain of basin hopping; checkpoints after every hop. Summary: cost, hops, seconds.
Result<worker::TaskOutputs> RunIdentify(const worker::TaskInput& input, worker::TaskContext& context);

// The best chain's parameters: judged before and after on the recording, with what the data determine of
// them; the next model; the iteration's result as JSON (what `run` prints and draws).
Result<worker::TaskOutputs> RunConclude(const worker::TaskInput& input, worker::TaskContext& context);

}  // namespace rg::jobs
