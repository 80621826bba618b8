// The functions that workers and agents run: one per kind of kinds.h. Payloads: payloads.proto.
#pragma once

namespace rg::worker {
class TaskRegistry;
}

namespace rg::jobs {

// trajectories, train, identify, conclude …: what an iteration without --diagnose takes.
void RegisterIterationKinds(worker::TaskRegistry* registry);
// Everything that any worker can do.
void RegisterWorkerKinds(worker::TaskRegistry* registry);

}  // namespace rg::jobs
