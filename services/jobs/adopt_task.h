// Task kind `adopt`: what a diagnosis brought beside identification alone, and which model goes on.
#pragma once

#include "common/base/status.h"
#include "worker/task_registry.h"

namespace rg::jobs {

// The next model is the diagnosed one as identification left it where that is better over all rollouts, in
// windows and open loop; else as the diagnosis left it; the identified one where neither can be simulated.
// Outputs: result (that of `conclude` with "diagnosis" added), model, parameters. Summary: verdict, names,
// errors.
Result<worker::TaskOutputs> RunAdopt(const worker::TaskInput& input, worker::TaskContext& context);

}  // namespace rg::jobs
