// From what a client submits to what the core schedules; the one place where a submitted graph is
// checked. After this the core trusts it.
#pragma once

#include <memory>

#include "common/base/status.h"
#include "coordinator/core/types.h"
#include "realitygrad/v1/job.pb.h"

namespace rg::coordinator {

struct CompiledJob {
  std::shared_ptr<const JobPlan> plan;
  std::shared_ptr<const TaskSpecs> specs;
};

// kInvalid, naming task, field, value and limit: no tasks or too many, a name twice, an unknown task
// or stage in an input, a cycle, an input without a source, a hash that is none, a negative weight.
// `parent`: the task that submits it (JobPlan::parent).
Result<CompiledJob> CompileJob(const realitygrad::v1::JobSpec& spec, TaskId parent = 0);

}  // namespace rg::coordinator
