#include "robot_agent/guard_program.h"

int main(int argc, char** argv) { return rg::robot_agent::GuardProgramMain(argc, argv); }
