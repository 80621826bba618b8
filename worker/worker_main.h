// The worker program as a function, so that several programs share it: realitygrad-worker with the
// kinds of services/jobs, realitygrad-agent with the kind `rollout`, and the tests' own.
#pragma once

#include <functional>
#include <optional>
#include <string>

#include "worker/task_registry.h"

namespace rg::worker {

// Parses the flags (--help lists them), joins the coordinator and runs tasks until SIGTERM or SIGINT
// (drain: finish what runs, at most --drain-timeout seconds; a second signal stops at once).
// The same program, started again by the worker with --executor-fd, is the child in which tasks run;
// this call then never leaves that role. Call it first thing in main: no threads, no output before.
// Exit codes: 0 drained, 1 error, 2 usage, 6 coordinator unreachable (only with --patience).
int WorkerMain(int argc, char** argv, const TaskRegistry& registry);

// The same for the program beside the robot: it speaks as an agent, has one slot, and carries the
// tag robot:NAME (--robot NAME).
// `waits_for`: WorkerOptions::waits_for.
int AgentMain(int argc, char** argv, const TaskRegistry& registry, std::function<std::string()> waits_for = {});

// For programs with flags of their own: if this process was started as an executor child, serves as
// one and returns its exit code; else nothing.
std::optional<int> ServeIfExecutor(int argc, char** argv, const TaskRegistry& registry);

}  // namespace rg::worker
