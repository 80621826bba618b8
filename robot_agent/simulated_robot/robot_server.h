// Serves one driver over a packet socket until it says Bye or goes away: in real time (the world
// follows CLOCK_MONOTONIC) or in lock-step (the world moves when asked), as the driver's Hello says.
#pragma once

#include "common/base/status.h"
#include "robot_agent/drivers/packet_socket.h"
#include "robot_agent/simulated_robot/robot_world.h"

namespace rg::robot_agent {

// Ok: the driver left in order or vanished.
Status ServeRobot(RobotWorld& world, const PacketSocket& socket, bool allow_faults);

}  // namespace rg::robot_agent
