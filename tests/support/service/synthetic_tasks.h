// Task kinds that compute nothing, for tests of the service. Payloads are JSON objects.
//
//   echo     {"text"}                 output "out": the text, then the bytes of all inputs
//   sleep    {"seconds"}              sleeps, reports progress, stops when cancelled; output "out"
//   fail     {"code", "until"}        fails with the status code on attempts <= until (absent: always)
//   crash    {"until"}                kills its process on attempts <= until (absent: always)
//   garble   {}                       prints, logs and fails with bytes that are no text
//   hang     {}                       neither returns nor looks whether it is cancelled
//   stop_slowly {"path", "needs"}     when it is cancelled it needs so many seconds, then is "append"; has 60 s of grace
//   count    {"to", "step_seconds"}   counts with a checkpoint per step; output "out": where it began,
//                                     the attempt, and the end
//   blob     {"bytes", "seed"}        output "out": that many bytes, always the same
//   append   {"path", "line"}         appends a line to a file: shows how often a task really ran
//   parameters {"robot", "value"}     output "out" of kind parameters
//   lead     {"parts", "seconds", "leave"}  submits a job of "sleep" tasks and waits for what they say
//   rollout  as append                of agents only: the kind that moves a robot
#pragma once

#include "worker/task_registry.h"

namespace rg::testing {

worker::TaskRegistry SyntheticTasks();
worker::TaskRegistry SyntheticRobotTasks();
void AddSyntheticRobotTasks(worker::TaskRegistry* registry);

}  // namespace rg::testing
