// The driver of an arm whose controller speaks lines of text over TCP; the example of docs/new-robot.md.
#pragma once

#include "robot_agent/drivers/driver_registry.h"

namespace bench_arm {

// {"address": "127.0.0.1", "port": 7400, "joints": ["shoulder", "elbow"]}
rg::Result<std::unique_ptr<rg::robot_agent::Driver>> MakeBenchArm(const rg::robot_agent::DriverRequest& request);

}  // namespace bench_arm
