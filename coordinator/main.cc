#include "coordinator/server/coordinator_main.h"

int main(int argc, char** argv) { return rg::coordinator::CoordinatorMain(argc, argv); }
