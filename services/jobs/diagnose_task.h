// Task kind `diagnose`: which physics a model leaves out, from a recording set, on any worker.
#pragma once

#include "common/base/status.h"
#include "worker/task_registry.h"

namespace rg::jobs {

// Outputs: diagnosis (diagnosis.json), model (model.json), report (report.html). Summary: verdict, findings
// and held-out errors.
Result<worker::TaskOutputs> RunDiagnose(const worker::TaskInput& input, worker::TaskContext& context);

}  // namespace rg::jobs
