// ArmLink over roscpp. A process has one ROS node and one master: the first link decides, a later one with
// another master is refused. Built where roscpp is (rg_kinova_ros).
#pragma once

#include <memory>

#include "robot_agent/drivers/kinova/arm_link.h"

namespace rg::robot_agent::kinova {

std::unique_ptr<ArmLink> MakeRosArmLink(const KinovaOptions& options);

}  // namespace rg::robot_agent::kinova
