#include "robot_agent/stand_in/stand_in_config.h"

#include <filesystem>
#include <nlohmann/json.hpp>
#include <set>

#include "common/base/file.h"
#include "robot_agent/drivers/json_fields.h"
#include "robot_agent/drivers/kinova/joint_report.h"

namespace rg::robot_agent::stand_in {
namespace {

using nlohmann::json;

const std::set<std::string> kFields = {"format",
                                       "robot_type",
                                       "robot_name",
                                       "truth",
                                       "call_s",
                                       "jitter_s",
                                       "lost_at_start_s",
                                       "sensor_offset_nm",
                                       "switch_threshold_nm",
                                       "turns",
                                       "limit_distance_deg",
                                       "torque_sign",
                                       "outage_after_s",
                                       "refuse_torque_mode",
                                       "outage_s",
                                       "outages_per_s",
                                       "leave_torque_mode_s"};

Result<StandInConfig> Read(const json& root, const std::string& folder) {
  for (const auto& [key, value] : root.items())
    if (!kFields.contains(key)) return InvalidError("unknown field \"" + key + "\"");
  if (root.at("format") != "realitygrad.stand_in/1")
    return InvalidError("format is " + root.at("format").dump() + ", needs realitygrad.stand_in/1");
  StandInConfig config;
  config.robot_type = root.value("robot_type", config.robot_type);
  config.robot_name = root.value("robot_name", config.robot_type);
  RG_ASSIGN_OR_RETURN(const int n, kinova::JointsOfType(config.robot_type));
  config.truth_path = (std::filesystem::path(folder) / root.at("truth").get<std::string>()).string();
  RG_RETURN_IF_ERROR(ReadVector(root, "sensor_offset_nm", n, 0.0, &config.sensor_offset_nm));
  RG_RETURN_IF_ERROR(ReadVector(root, "turns", n, 0, &config.turns));
  RG_RETURN_IF_ERROR(ReadVector(root, "torque_sign", n, 1.0, &config.torque_sign));
  config.refuse_torque_mode = root.value("refuse_torque_mode", 0);
  RG_RETURN_IF_ERROR(ReadNumber(root, "call_s", 0, 0.1, &config.call_s));
  RG_RETURN_IF_ERROR(ReadNumber(root, "jitter_s", 0, 0.1, &config.jitter_s));
  RG_RETURN_IF_ERROR(ReadNumber(root, "lost_at_start_s", 0, 10, &config.lost_at_start_s));
  RG_RETURN_IF_ERROR(ReadNumber(root, "switch_threshold_nm", 0.1, 100, &config.switch_threshold_nm));
  RG_RETURN_IF_ERROR(ReadNumber(root, "limit_distance_deg", 0, 45, &config.limit_distance_deg));
  RG_RETURN_IF_ERROR(ReadNumber(root, "leave_torque_mode_s", 0, 1e6, &config.leave_torque_mode_s));
  RG_RETURN_IF_ERROR(ReadNumber(root, "outage_after_s", 0, 1e6, &config.outage_after_s));
  RG_RETURN_IF_ERROR(ReadNumber(root, "outage_s", 0.1, 60, &config.outage_s));
  RG_RETURN_IF_ERROR(ReadNumber(root, "outages_per_s", 0, 1, &config.outages_per_s));
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
