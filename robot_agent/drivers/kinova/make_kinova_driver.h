// The driver `kinova` with its link to ROS, or a refusal that says what this build lacks.
#pragma once

#include <memory>

#include "robot_agent/drivers/driver.h"
#include "robot_agent/drivers/kinova/kinova_options.h"

namespace rg::robot_agent::kinova {

// kFailedPrecondition: this build has no ROS.
Status CheckKinovaIsBuilt();
Result<std::unique_ptr<Driver>> MakeKinovaDriver(const KinovaOptions& options);

}  // namespace rg::robot_agent::kinova
