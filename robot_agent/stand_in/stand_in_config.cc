#include "robot_agent/stand_in/stand_in_config.h"

#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "common/base/json_fields.h"
#include "robot_agent/drivers/kinova/joint_report.h"

namespace rg::robot_agent::stand_in {
namespace {

using nlohmann::json;

Result<StandInConfig> Read(const json& root, const std::string& folder) {
  JsonFields fields(
      root,
      "format robot_type robot_name truth call_s jitter_s lost_at_start_s sensor_offset_nm "
      "switch_threshold_nm turns limit_distance_deg torque_sign outage_after_s refuse_torque_mode outage_s "
      "outages_per_s leave_torque_mode_s");
  fields.Format("realitygrad.stand_in/1");
  StandInConfig config;
  fields.Read("robot_type", &config.robot_type);
  config.robot_name = config.robot_type;
  fields.Read("robot_name", &config.robot_name);
  fields.Require("truth", &config.truth_path);
  RG_RETURN_IF_ERROR(fields.status());
  RG_ASSIGN_OR_RETURN(const int n, kinova::JointsOfType(config.robot_type));
  config.truth_path = (std::filesystem::path(folder) / config.truth_path).string();
  config.sensor_offset_nm.assign(n, 0.0), config.turns.assign(n, 0), config.torque_sign.assign(n, 1.0);
  fields.Values("sensor_offset_nm", n, &config.sensor_offset_nm);
  fields.Values("turns", n, &config.turns);
  fields.Values("torque_sign", n, &config.torque_sign);
  fields.Read("refuse_torque_mode", &config.refuse_torque_mode);
  fields.Number("call_s", 0, 0.1, &config.call_s);
  fields.Number("jitter_s", 0, 0.1, &config.jitter_s);
  fields.Number("lost_at_start_s", 0, 10, &config.lost_at_start_s);
  fields.Number("switch_threshold_nm", 0.1, 100, &config.switch_threshold_nm);
  fields.Number("limit_distance_deg", 0, 45, &config.limit_distance_deg);
  fields.Number("leave_torque_mode_s", 0, 1e6, &config.leave_torque_mode_s);
  fields.Number("outage_after_s", 0, 1e6, &config.outage_after_s);
  fields.Number("outage_s", 0.1, 60, &config.outage_s);
  fields.Number("outages_per_s", 0, 1, &config.outages_per_s);
  RG_RETURN_IF_ERROR(fields.status());
  return config;
}

}  // namespace

Result<StandInConfig> LoadStandInConfig(const std::string& path) {
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  try {
    auto config = Read(json::parse(text), std::filesystem::path(path).parent_path().string());
    if (!config.ok()) return config.status().WithPrefix(path);
    return config;
  } catch (const json::exception& error) {
    return InvalidError(path + ": " + error.what());
  }
}

}  // namespace rg::robot_agent::stand_in
