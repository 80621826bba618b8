// first/realitygrad-worker, which deploy/quickstart builds before the rest: the kinds of an iteration.
#include "services/jobs/task_kinds.h"
#include "worker/worker_main.h"

int main(int argc, char** argv) {
  rg::worker::TaskRegistry registry;
  rg::jobs::RegisterIterationKinds(&registry);
  return rg::worker::WorkerMain(argc, argv, registry);
}
