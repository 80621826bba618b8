// A worker program with the synthetic kinds.
#include "tests/support/service/synthetic_tasks.h"
#include "worker/worker_main.h"

int main(int argc, char** argv) { return rg::worker::WorkerMain(argc, argv, rg::testing::SyntheticTasks()); }
