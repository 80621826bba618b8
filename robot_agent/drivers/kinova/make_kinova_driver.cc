#include "robot_agent/drivers/kinova/make_kinova_driver.h"

#ifdef RG_WITH_ROS
#include "robot_agent/drivers/kinova/kinova_driver.h"
#include "robot_agent/drivers/kinova/ros_arm_link.h"
#endif

namespace rg::robot_agent::kinova {

Status CheckKinovaIsBuilt() {
#ifdef RG_WITH_ROS
  return Status::Ok();
#else
  return FailedPreconditionError(
      "driver \"kinova\" is not in this build: install what `realitygrad doctor` names and build again");
#endif
}

Result<std::unique_ptr<Driver>> MakeKinovaDriver([[maybe_unused]] const KinovaOptions& options) {
#ifdef RG_WITH_ROS
  return std::unique_ptr<Driver>(std::make_unique<KinovaDriver>(options, MakeRosArmLink(options)));
#else
  return CheckKinovaIsBuilt();
#endif
}

}  // namespace rg::robot_agent::kinova
