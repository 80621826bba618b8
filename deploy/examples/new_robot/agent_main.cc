// realitygrad-agent with one driver more.
#include "bench_arm_driver.h"
#include "robot_agent/agent_program.h"

int main(int argc, char** argv) {
  rg::robot_agent::RegisterDriver("bench_arm", bench_arm::MakeBenchArm);
  return rg::robot_agent::AgentProgramMain(argc, argv);
}
