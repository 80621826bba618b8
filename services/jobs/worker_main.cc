// realitygrad-worker: runs the task kinds of services/jobs.
#include "worker/worker_main.h"
#include "services/jobs/task_kinds.h"

int main(int argc, char** argv) {
  rg::worker::TaskRegistry registry;
  rg::jobs::RegisterWorkerKinds(&registry);
  return rg::worker::WorkerMain(argc, argv, registry);
}
