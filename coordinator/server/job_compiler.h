// From what a client submits to what the core schedules; the one place where a submitted graph is
// checked. After this the core trusts it.
#pragma once

#include <memory>
#include <set>
#include <string>

#include "common/base/status.h"
#include "coordinator/core/types.h"
#include "realitygrad/v1/job.pb.h"

namespace rg::coordinator {

struct CompiledJob {
  std::shared_ptr<const JobPlan> plan;
  std::shared_ptr<const TaskSpecs> specs;
};

// Of jobs and tasks, as clients ask for them.
constexpr int32_t kMaxPriority = 1'000'000;
// kInvalid outside of ±kMaxPriority.
Status CheckPriority(int32_t priority);

// kInvalid, naming task, field, value and limit: no tasks or too many, a name twice, an unknown task
// or stage in an input, a cycle, an input without a source, a hash that is none, a negative weight.
// Names and labels with characters that a terminal would obey are refused too.
// `parent`: the task that submits it (JobPlan::parent). Tasks of `robot_kinds` run at most once, others as
// often as it takes, whatever the specification says.
Result<CompiledJob> CompileJob(const realitygrad::v1::JobSpec& spec, TaskId parent = 0,
                               const std::set<std::string>& robot_kinds = {});
// What JobPlan::content is: a hash of all of it but who submitted it, and how it is shown.
std::string ContentOf(const realitygrad::v1::JobSpec& spec);

}  // namespace rg::coordinator
