// realitygrad-worker: runs the task kinds of services/jobs.
#include "services/jobs/task_kinds.h"
#include "worker/worker_main.h"

int main(int argc, char** argv) {
  rg::worker::TaskRegistry registry;
  rg::jobs::RegisterWorkerKinds(&registry);
  return rg::worker::WorkerMain(argc, argv, registry);
}
