#include "robot_agent/agent_config.h"

#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <set>

#include "common/base/file.h"
#include "common/model/urdf_loader.h"

namespace rg::robot_agent {
namespace {

using nlohmann::json;

constexpr double kLimitMargin = 0.02;  // rad (m)

std::string Resolve(const std::string& folder, const std::string& path) {
  return path.empty() ? path : (std::filesystem::path(folder) / path).lexically_normal().string();
}

std::vector<std::string> JointNames(const model::RobotModel& model) {
  std::vector<std::string> names;
  for (const auto& joint : model.joints()) names.push_back(joint.name);
  return names;
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

Status ReadArm(const json& root, const std::string& folder, AgentConfig* config) {
  if (!root.contains("urdf"))
    return InvalidError(
        "\"urdf\" is missing: the arm's own kinematics and gravity, which no job's model replaces");
  model::LoadOptions options;
  options.joints = root.value("joints", options.joints);
  options.locked = root.value("locked", options.locked);
  options.end_effector = root.value("end_effector", options.end_effector);
  config->gravity = root.value("gravity", config->gravity);
  if (config->gravity.size() != 3) return InvalidError("gravity needs three numbers");
  RG_ASSIGN_OR_RETURN(auto arm,
                      model::LoadUrdf(Resolve(folder, root.at("urdf").get<std::string>()), options));
  if (arm.num_joints() > kMaxJoints)
    return InvalidError("urdf: " + std::to_string(arm.num_joints()) + " joints, at most " +
                        std::to_string(kMaxJoints));
  config->arm = std::make_shared<const model::RobotModel>(std::move(arm));
  return Status::Ok();
}

Status CheckPositive(const char* field, double value) {
  if (std::isfinite(value) && value > 0.0) return Status::Ok();
  return InvalidError(std::string(field) + " is " + std::to_string(value) + ", needs a positive number");
}

Status ReadFence(const json& root, AgentConfig* config) {
  RG_RETURN_IF_ERROR(CheckPositive("max_rate_hz", config->max_rate_hz));
  RG_RETURN_IF_ERROR(CheckPositive("max_duration_s", config->max_duration_s));
  RG_RETURN_IF_ERROR(CheckPositive("min_free_mb", config->min_free_mb));
  RG_RETURN_IF_ERROR(CheckPositive("pose_tolerance", config->pose_tolerance));
  RG_RETURN_IF_ERROR(CheckPositive("pose_timeout_s", config->pose_timeout_s));
  if (!root.contains("limits"))
    return InvalidError("\"limits\" is missing: the boxes that the arm has to stay in");
  RG_ASSIGN_OR_RETURN(config->limits, ParseLimits(root["limits"].dump(), "limits"));
  return ValidateLimits(config->limits, JointNames(*config->arm), config->start_pose);
}

Result<AgentConfig> Read(const json& root, const std::string& folder) {
  RG_RETURN_IF_ERROR(CheckKeys(root,
                               {"format",
                                "name",
                                "driver",
                                "simulated",
                                "start_pose",
                                "pose_tolerance",
                                "pose_timeout_s",
                                "settle_s",
                                "connect_timeout_s",
                                "limits",
                                "velocity_source",
                                "excitation",
                                "urdf",
                                "joints",
                                "locked",
                                "end_effector",
                                "gravity",
                                "max_rate_hz",
                                "max_duration_s",
                                "min_free_mb"},
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
  config.max_rate_hz = root.value("max_rate_hz", config.max_rate_hz);
  config.max_duration_s = root.value("max_duration_s", config.max_duration_s);
  config.min_free_mb = root.value("min_free_mb", config.min_free_mb);
  const std::string source = root.value("velocity_source", "measured");
  if (source != "measured" && source != "differenced")
    return InvalidError("velocity_source is \"" + source + "\", needs measured or differenced");
  config.velocity_source = source == "measured" ? VelocitySource::kMeasured : VelocitySource::kDifferenced;
  config.excitation = root.value("excitation", 0.0);
  if (!(config.excitation >= 0.0 && config.excitation <= 1.0))
    return InvalidError("excitation is " + std::to_string(config.excitation) + ", needs 0 to 1");
  if (config.driver != "simulated")
    return InvalidError("driver \"" + config.driver + "\" is not in this build (simulated)");
  RG_RETURN_IF_ERROR(ReadSimulated(root.at("simulated"), folder, &config.simulated));
  RG_RETURN_IF_ERROR(ReadArm(root, folder, &config));
  RG_RETURN_IF_ERROR(ReadFence(root, &config));
  return config;
}

// What a job's model may ask for. Its speed limits are those of the arm's position mode; how fast a rollout
// may be is the configuration's alone.
TighterLimits AskedBy(const model::RobotModel& model) {
  TighterLimits asked;
  for (const auto& joint : model.joints()) {
    asked.lower.push_back(joint.lower + kLimitMargin);
    asked.upper.push_back(joint.upper - kLimitMargin);
    asked.torque.push_back(joint.effort);
  }
  return asked;
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
  RG_ASSIGN_OR_RETURN(AgentConfig config,
                      ParseAgentConfig(text, std::filesystem::path(path).parent_path().string(), path));
  config.path = path;
  return config;
}

Result<SafetyLimits> LimitsFor(const AgentConfig& config, const model::RobotModel& model,
                               const std::vector<double>& start) {
  const std::vector<std::string> joints = JointNames(model), own = JointNames(*config.arm);
  if (joints != own) {
    std::string ours, theirs;
    for (const auto& name : own) ours += " " + name;
    for (const auto& name : joints) theirs += " " + name;
    return InvalidError("the arm of agent " + config.name + " has the joints" + ours + ", the job's model" +
                        theirs);
  }
  const auto limits = Tighten(config.limits, AskedBy(model), joints);
  if (!limits.ok()) return limits.status().WithPrefix("with the limits of the job's model");
  RG_RETURN_IF_ERROR(ValidateLimits(*limits, joints, start));
  return limits;
}

Result<std::unique_ptr<Driver>> MakeDriver(const AgentConfig& config, uint64_t robot_seed) {
  if (config.driver != "simulated")
    return InvalidError("driver \"" + config.driver + "\" is not in this build");
  SimulatedDriverOptions options = config.simulated;
  options.seed = robot_seed;
  return std::unique_ptr<Driver>(std::make_unique<SimulatedDriver>(std::move(options)));
}

}  // namespace rg::robot_agent
