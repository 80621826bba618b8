// The ROS master and the stand-in of `run --driver kinova --stand-in`: on loopback, on a port of their own,
// with ROS_HOME in the run's folder. They outlive the agent, whose last word to the arm is position mode.
#pragma once

#include <string>

#include "common/base/status.h"
#include "services/cli/child_processes.h"

namespace rg::cli {

struct RosStandInOptions {
  std::string folder;  // of the run; logs and ROS_HOME
  std::string config;  // realitygrad.stand_in/1
  uint64_t seed = 1;
};

// kFailedPrecondition naming what is missing: the master's or the stand-in's program.
Status CheckRosStandIn();
// Starts both and tells the programs that are started after it where the master is (ROS_MASTER_URI, …).
Status StartRosStandIn(const RosStandInOptions& options, ChildProcesses* children);

}  // namespace rg::cli
