#include "robot_agent/drivers/kinova/kinova_options.h"

#include <nlohmann/json.hpp>

#include "common/base/json_fields.h"
#include "robot_agent/drivers/kinova/joint_report.h"

namespace rg::robot_agent::kinova {
namespace {

using nlohmann::json;

// Joints 2 and 3 of an arm of six, 2, 4 and 6 of one of seven have stops.
std::vector<bool> ContinuousJoints(int n) {
  if (n == 7) return {true, false, true, false, true, false, true};
  std::vector<bool> continuous(n, true);
  continuous[1] = continuous[2] = false;
  return continuous;
}

// Known by heart for the Mico² only; of another arm the laboratory says them.
void TakeDefaults(KinovaOptions* options) {
  if (options->robot_type.rfind("m1n6", 0) != 0) return;
  options->zero_pose_deg = {0, 180, 180, 0, 0, 0};
  options->test_torque_nm = {2, 4, 2, 1, 1, 1};
}

Result<KinovaOptions> Read(const json& root, const std::string& robot) {
  JsonFields fields(
      root,
      "stop_topic robot_type robot_name master joints zero_pose_deg zero_limit_nm test_torque_nm "
      "least_rate_hz outage_s farewell_s command_timeout_s service_timeout_s test_motion_rad "
      "torque_mode_attempts prepare_every_s");
  KinovaOptions options;
  options.robot = robot;
  fields.Read("robot_type", &options.robot_type);
  RG_RETURN_IF_ERROR(fields.status());
  RG_ASSIGN_OR_RETURN(const int n, JointsOfType(options.robot_type));
  options.robot_name = options.robot_type;
  fields.Read("robot_name", &options.robot_name);
  fields.Read("master", &options.master_uri);
  fields.Read("stop_topic", &options.stop_topic);
  if (options.stop_topic.empty() || options.stop_topic[0] != '/')
    fields.Fail("stop_topic is \"" + options.stop_topic + "\", needs a name that begins with /");
  options.continuous = ContinuousJoints(n);
  for (int i = 1; i <= n; ++i) options.joints.push_back("joint_" + std::to_string(i));
  fields.Read("joints", &options.joints);
  if (options.n() != n)
    fields.Fail("joints has " + std::to_string(options.n()) + " names, a " + options.robot_type + " has " +
                std::to_string(n));
  TakeDefaults(&options);
  fields.Numbers("zero_pose_deg", n, -720, 720, &options.zero_pose_deg);
  fields.Numbers("test_torque_nm", n, 0.05, 20, &options.test_torque_nm);
  fields.Number("zero_limit_nm", 0.01, 20, &options.zero_limit_nm);
  fields.Number("test_motion_rad", 0.005, 0.1, &options.test_motion_rad);
  fields.Number("least_rate_hz", 5, 1000, &options.least_rate_hz);
  fields.Number("outage_s", 0.2, 10, &options.outage_s);
  fields.Number("command_timeout_s", 0.02, 0.25, &options.command_timeout_s);
  fields.Number("service_timeout_s", 0.1, 3, &options.service_timeout_s);
  fields.Number("farewell_s", 0, 600, &options.farewell_s);
  fields.Number("prepare_every_s", 0, 1e5, &options.prepare_every_s);
  fields.Number("torque_mode_attempts", 1, 10, &options.torque_mode_attempts);
  RG_RETURN_IF_ERROR(fields.status());
  return options;
}

}  // namespace

Result<KinovaOptions> ParseKinovaOptions(const std::string& text, const std::string& robot) {
  try {
    auto options = Read(json::parse(text), robot);
    if (!options.ok()) return options.status().WithPrefix("kinova");
    return options;
  } catch (const json::exception& error) {
    return InvalidError(std::string("kinova: ") + error.what());
  }
}

}  // namespace rg::robot_agent::kinova
