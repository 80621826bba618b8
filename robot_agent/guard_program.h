// realitygrad-guard: stands between the agent and its arm (guard/guard.h). Started by the agent.
#pragma once

namespace rg::robot_agent {

int GuardProgramMain(int argc, char** argv);

}  // namespace rg::robot_agent
