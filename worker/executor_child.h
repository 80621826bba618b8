// The child's side: a process that runs one task after the other for the worker that started it.
#pragma once

#include "worker/task_registry.h"

namespace rg::worker {

// Serves on the socket `fd` until the worker closes it; returns the exit code. When the worker dies
// in the middle of a task this process ends at once.
int ServeAsExecutor(int fd, const TaskRegistry& registry);

}  // namespace rg::worker
