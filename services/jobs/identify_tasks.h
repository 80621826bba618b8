// Task kinds `identify` and `conclude`.
#pragma once

#include "common/base/status.h"
#include "services/jobs/identify_problem.h"
#include "services/sysid/basin_hopping.h"
#include "worker/task_registry.h"

namespace rg::jobs {

// One round of one chain of basin hopping; checkpoints after every hop. Summary: cost, hops, seconds.
Result<worker::TaskOutputs> RunIdentify(const worker::TaskInput& input, worker::TaskContext& context);

// The best chain's parameters: judged before and after on the recording, with what the data determine of
// them; the next model; the iteration's result as JSON (what `run` prints and draws).
Result<worker::TaskOutputs> RunConclude(const worker::TaskInput& input, worker::TaskContext& context);

// The options of a search's last round, which weighs long predictions too.
IdentifyProblemOptions LastRoundOf(const realitygrad::v1::IdentifyPayload& payload);
// The best of the input's chains by the cost of `problem`, whatever costs they ended on. An error when none
// could be simulated.
Result<sysid::HopState> BestChain(const worker::TaskInput& input, const IdentifyProblem& problem);

}  // namespace rg::jobs
