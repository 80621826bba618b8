// realitygrad-agent: runs rollouts on the robot beside it.
#include "robot_agent/agent_program.h"

int main(int argc, char** argv) { return rg::robot_agent::AgentProgramMain(argc, argv); }
