// A ROS master and an arm's driver that come a second after the rollout asked for them, as after a power cut: through
// real topics.
#include <gmock/gmock.h>

#include <chrono>
#include <optional>
#include <thread>

#include "robot_agent/drivers/kinova/kinova_driver.h"
#include "robot_agent/drivers/kinova/ros_arm_link.h"
#include "tests/integration/kinova/ros_rig.h"
#include "tests/unit/robot_agent/rig.h"

namespace rg::robot_agent {
namespace {

using testing::HasSubstr;

class AwayMaster : public RosTest {};

TEST_F(AwayMaster, IsConnectedToAgainWhenItIsBack) {
  Rig rig(true);
  rig.config.driver = "kinova";
  rig.config.connect_timeout_s = 60.0;
  rig.config.start_attempts = 10;
  const RolloutPlan plan = rig.Plan();
  auto controller = rig.ToGoal(plan);
  const RolloutInput input{.plan = plan, .config = rig.config, .plant = rig.plant, .controller = controller};
  // Times are wide: the machine may be busy with other tests.
  auto options = kinova::ParseKinovaOptions(R"({"least_rate_hz": 5, "command_timeout_s": 0.25})", "mico2").value();
  options.service_timeout_s = 10;
  kinova::KinovaDriver driver(options, kinova::MakeRosArmLink(options));
  master_->Stop();
  std::optional<Child> arm;
  std::vector<std::string> notes;
  const auto listen = [&](const ProgressUpdate& update) {
    notes.push_back(update.note);
    if (update.note == "the arm was away: connecting again" && !arm) {
      StartMaster();
      arm.emplace(StartStandIn([](nlohmann::json&) {}));
    }
    if (update.note == "to the start pose") rig.stop.Cancel();  // it is connected: that is all
  };
  const Status end = RunRollout(driver, input, *rig.spool, listen, rig.stop, RealClock()).status();
  EXPECT_EQ(end.code(), StatusCode::kCancelled) << end.ToString();
  EXPECT_EQ(notes.front(), "the arm was away: connecting again");
  EXPECT_EQ(notes.back(), "to the start pose");
  EXPECT_TRUE(driver.health().connected);
}

}  // namespace
}  // namespace rg::robot_agent
