#include "robot_agent/agent_config.h"

#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <numbers>
#include <set>

#include "common/base/file.h"
#include "robot_agent/drivers/kinova/make_kinova_driver.h"

namespace rg::robot_agent {
namespace {

using nlohmann::json;

constexpr double kLimitMargin = 0.02;   // rad (m)
constexpr double kVelocityRatio = 1.5;  // of the URDF's limit
constexpr double kVelocityWithoutLimit = 5.0;

std::string Resolve(const std::string& folder, const std::string& path) {
  return path.empty() ? path : (std::filesystem::path(folder) / path).lexically_normal().string();
}

Status CheckKeys(const json& object, const std::set<std::string>& known, const std::string& where) {
  for (const auto& [key, value] : object.items())
    if (!known.contains(key)) return InvalidError(where + "unknown field \"" + key + "\"");
  return Status::Ok();
}

Status ReadSimulated(const json& object, const std::string& folder, SimulatedDriverOptions* options) {
  RG_RETURN_IF_ERROR(
      CheckKeys(object, {"truth", "lock_step", "socket", "program", "reply_timeout_s"}, "simulated: "));
  options->truth_path = Resolve(folder, object.value("truth", ""));
  options->socket_path = object.value("socket", "");
  options->program = object.value("program", "");
  options->lock_step = object.value("lock_step", false);
  options->reply_timeout_s = object.value("reply_timeout_s", options->reply_timeout_s);
  if (options->truth_path.empty() && options->socket_path.empty())
    return InvalidError("simulated: needs \"truth\" or \"socket\"");
  return Status::Ok();
}

Status ReadReplay(const json& object, const std::string& folder, ReplayOptions* options) {
  RG_RETURN_IF_ERROR(CheckKeys(object, {"set", "recording", "lock_step"}, "replay: "));
  options->folder = Resolve(folder, object.at("set").get<std::string>());
  options->recording = object.value("recording", "");
  options->lock_step = object.value("lock_step", false);
  return Status::Ok();
}

Result<AgentConfig> Read(const json& root, const std::string& folder) {
  RG_RETURN_IF_ERROR(CheckKeys(
      root,
      {"format", "name", "driver", "simulated", "kinova", "replay", "start_pose", "pose_tolerance",
       "pose_timeout_s", "settle_s", "connect_timeout_s", "limits", "velocity_source", "excitation"},
      ""));
  if (root.at("format") != "realitygrad.agent/1")
    return InvalidError("format is " + root.at("format").dump() + ", needs realitygrad.agent/1");
  AgentConfig config;
  root.at("name").get_to(config.name);
  root.at("start_pose").get_to(config.start_pose);
  config.driver = root.value("driver", config.driver);
  config.pose_tolerance = root.value("pose_tolerance", config.pose_tolerance);
  config.pose_timeout_s = root.value("pose_timeout_s", config.pose_timeout_s);
  config.settle_s = root.value("settle_s", config.settle_s);
  config.connect_timeout_s = root.value("connect_timeout_s", config.connect_timeout_s);
  config.limits_json = root.value("limits", json::object()).dump();
  const std::string source = root.value("velocity_source", "measured");
  if (source != "measured" && source != "differenced")
    return InvalidError("velocity_source is \"" + source + "\", needs measured or differenced");
  config.velocity_source = source == "measured" ? VelocitySource::kMeasured : VelocitySource::kDifferenced;
  config.excitation = root.value("excitation", 0.0);
  if (!(config.excitation >= 0.0 && config.excitation <= 1.0))
    return InvalidError("excitation is " + std::to_string(config.excitation) + ", needs 0 to 1");
  if (config.driver == "kinova") {
    RG_RETURN_IF_ERROR(kinova::CheckKinovaIsBuilt());
    RG_ASSIGN_OR_RETURN(config.kinova,
                        kinova::ParseKinovaOptions(root.value("kinova", json::object()).dump(), config.name));
    return config;
  }
  if (config.driver == "replay") {
    config.replay.robot = config.name;
    RG_RETURN_IF_ERROR(ReadReplay(root.at("replay"), folder, &config.replay));
    return config;
  }
  if (config.driver != "simulated")
    return InvalidError("driver is \"" + config.driver + "\", needs simulated, kinova or replay");
  RG_RETURN_IF_ERROR(ReadSimulated(root.at("simulated"), folder, &config.simulated));
  return config;
}

SafetyLimits LimitsOfModel(const model::RobotModel& model, const std::vector<double>& start) {
  SafetyLimits limits;
  for (int i = 0; i < model.num_joints(); ++i) {
    const auto& joint = model.joint(i);
    const bool bounded = std::isfinite(joint.lower) && std::isfinite(joint.upper);
    const double middle = i < static_cast<int>(start.size()) ? start[i] : 0.0;
    limits.lower.push_back(bounded ? joint.lower + kLimitMargin : middle - 2 * std::numbers::pi);
    limits.upper.push_back(bounded ? joint.upper - kLimitMargin : middle + 2 * std::numbers::pi);
    limits.velocity.push_back(std::isfinite(joint.velocity) ? kVelocityRatio * joint.velocity
                                                            : kVelocityWithoutLimit);
    limits.torque.push_back(joint.effort);
  }
  return limits;
}

}  // namespace

Result<AgentConfig> ParseAgentConfig(const std::string& text, const std::string& folder,
                                     const std::string& source) {
  try {
    auto config = Read(json::parse(text), folder);
    if (!config.ok()) return config.status().WithPrefix(source);
    return config;
  } catch (const json::exception& error) {
    return InvalidError(source + ": " + error.what());
  }
}

Result<AgentConfig> LoadAgentConfig(const std::string& path) {
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  return ParseAgentConfig(text, std::filesystem::path(path).parent_path().string(), path);
}

Result<SafetyLimits> LimitsFor(const AgentConfig& config, const model::RobotModel& model,
                               const std::vector<double>& start) {
  std::vector<std::string> joints;
  for (const auto& joint : model.joints()) joints.push_back(joint.name);
  RG_ASSIGN_OR_RETURN(SafetyLimits limits,
                      ParseLimits(config.limits_json, LimitsOfModel(model, start), config.name));
  RG_RETURN_IF_ERROR(ValidateLimits(limits, joints, start));
  return limits;
}

Result<std::unique_ptr<Driver>> MakeDriver(const AgentConfig& config, uint64_t robot_seed) {
  if (config.driver == "kinova") return kinova::MakeKinovaDriver(config.kinova);
  if (config.driver == "replay")
    return std::unique_ptr<Driver>(std::make_unique<ReplayDriver>(config.replay));
  SimulatedDriverOptions options = config.simulated;
  options.seed = robot_seed;
  return std::unique_ptr<Driver>(std::make_unique<SimulatedDriver>(std::move(options)));
}

}  // namespace rg::robot_agent
