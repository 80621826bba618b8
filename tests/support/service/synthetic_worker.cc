// A worker program with the synthetic kinds; with --robot NAME an agent, for the kind that moves one.
#include <cstring>

#include "tests/support/service/synthetic_tasks.h"
#include "worker/worker_main.h"

int main(int argc, char** argv) {
  for (int i = 1; i < argc; ++i) {
    if (std::strcmp(argv[i], "--robot") == 0)
      return rg::worker::AgentMain(argc, argv, rg::testing::SyntheticRobotTasks());
    if (std::strcmp(argv[i], "--executor-fd") != 0) continue;
    rg::worker::TaskRegistry all = rg::testing::SyntheticTasks();
    rg::testing::AddSyntheticRobotTasks(&all);
    return rg::worker::WorkerMain(argc, argv, all);
  }
  return rg::worker::WorkerMain(argc, argv, rg::testing::SyntheticTasks());
}
