#include "robot_agent/agent_config.h"

#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <set>

#include "common/base/file.h"
#include "common/model/urdf_loader.h"
#include "robot_agent/drivers/kinova/make_kinova_driver.h"
#include "robot_agent/safety/own_arm.h"

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

Status ReadReplay(const json& object, const std::string& folder, ReplayOptions* options) {
  RG_RETURN_IF_ERROR(CheckKeys(object, {"set", "recording", "lock_step"}, "replay: "));
  options->folder = Resolve(folder, object.at("set").get<std::string>());
  options->recording = object.value("recording", "");
  options->lock_step = object.value("lock_step", false);
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

Result<Eigen::Vector3d> ReadPoint(const json& object, const char* field, const std::string& name) {
  const auto point = object.at(field).get<std::vector<double>>();
  if (point.size() != 3 || !std::isfinite(point[0] + point[1] + point[2]))
    return InvalidError("capsules: " + name + ": " + field + " needs three finite numbers");
  return Eigen::Vector3d(point[0], point[1], point[2]);
}

Result<int> FindPart(const CapsuleSet& parts, const std::string& name) {
  for (size_t i = 0; i < parts.capsules.size(); ++i)
    if (parts.capsules[i].name == name) return static_cast<int>(i);
  return InvalidError("apart: there is no capsule \"" + name + "\"");
}

Status ReadParts(const json& root, AgentConfig* config) {
  if (root.contains("capsules") != root.contains("apart"))
    return InvalidError("\"capsules\" and \"apart\" go together");
  for (const json& object : root.value("capsules", json::array())) {
    RG_RETURN_IF_ERROR(CheckKeys(object, {"name", "link", "from", "to", "radius"}, "capsules: "));
    Capsule part;
    object.at("name").get_to(part.name);
    object.at("link").get_to(part.link);
    object.at("radius").get_to(part.radius);
    RG_ASSIGN_OR_RETURN(part.from, ReadPoint(object, "from", part.name));
    RG_ASSIGN_OR_RETURN(part.to, ReadPoint(object, "to", part.name));
    RG_RETURN_IF_ERROR(CheckPositive(("capsules: " + part.name + ": radius").c_str(), part.radius));
    if (!config->arm->FindFrame(part.link))
      return InvalidError("capsules: " + part.name + ": the URDF has no link \"" + part.link + "\"");
    if (FindPart(config->parts, part.name).ok())
      return InvalidError("capsules: \"" + part.name + "\" is there twice");
    config->parts.capsules.push_back(std::move(part));
  }
  for (const json& names : root.value("apart", json::array())) {
    const auto two = names.get<std::vector<std::string>>();
    if (two.size() != 2 || two[0] == two[1]) return InvalidError("apart: needs pairs of two names");
    RG_ASSIGN_OR_RETURN(const int a, FindPart(config->parts, two[0]));
    RG_ASSIGN_OR_RETURN(const int b, FindPart(config->parts, two[1]));
    config->parts.apart.emplace_back(a, b);
  }
  return Status::Ok();
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
  RG_RETURN_IF_ERROR(ValidateLimits(config->limits, JointNames(*config->arm), config->start_pose));
  RG_RETURN_IF_ERROR(ReadParts(root, config));
  OwnArm arm(*config->arm, Eigen::Map<const Eigen::Vector3d>(config->gravity.data()), config->parts);
  int pair = -1;
  const double clearance = arm.Clearance(config->start_pose.data(), &pair);
  if (clearance > 0.0) return Status::Ok();
  return InvalidError("apart: in the start pose the parts of pair " + std::to_string(pair + 1) + " are " +
                      std::to_string(clearance) + " m apart, which is a collision");
}

Status ReadFirstRollouts(const json& root, AgentConfig* config) {
  rollouts::FirstRollouts& first = config->first_rollouts;
  if (config->driver != "simulated" && config->driver != "replay") first = {.duration_s = 2.0, .speed = 0.4};
  if (!root.contains("first_rollouts")) return Status::Ok();
  if (root["first_rollouts"].is_null()) {
    first = {};
    return Status::Ok();
  }
  const json& object = root["first_rollouts"];
  RG_RETURN_IF_ERROR(CheckKeys(object, {"duration_s", "speed"}, "first_rollouts: "));
  object.at("duration_s").get_to(first.duration_s);
  object.at("speed").get_to(first.speed);
  RG_RETURN_IF_ERROR(CheckPositive("first_rollouts: duration_s", first.duration_s));
  RG_RETURN_IF_ERROR(CheckPositive("first_rollouts: speed", first.speed));
  if (first.speed <= 1.0) return Status::Ok();
  return InvalidError("first_rollouts: speed is " + std::to_string(first.speed) + ", needs at most 1");
}

Result<AgentConfig> Read(const json& root, const std::string& folder) {
  const std::string driver = root.value("driver", "simulated");
  const bool own = FindDriver(driver) != nullptr;
  RG_RETURN_IF_ERROR(CheckKeys(root,
                               {own ? driver : "format",
                                "format",
                                "name",
                                "driver",
                                "simulated",
                                "kinova",
                                "replay",
                                "start_pose",
                                "pose_tolerance",
                                "pose_timeout_s",
                                "settle_s",
                                "connect_timeout_s",
                                "start_attempts",
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
                                "min_free_mb",
                                "first_rollouts",
                                "capsules",
                                "apart"},
                               ""));
  if (root.at("format") != "realitygrad.agent/1")
    return InvalidError("format is " + root.at("format").dump() + ", needs realitygrad.agent/1");
  AgentConfig config;
  root.at("name").get_to(config.name);
  root.at("start_pose").get_to(config.start_pose);
  config.driver = driver;
  config.pose_tolerance = root.value("pose_tolerance", config.pose_tolerance);
  config.pose_timeout_s = root.value("pose_timeout_s", config.pose_timeout_s);
  config.settle_s = root.value("settle_s", config.settle_s);
  config.connect_timeout_s = root.value("connect_timeout_s", config.connect_timeout_s);
  config.start_attempts = root.value("start_attempts", config.start_attempts);
  if (config.start_attempts < 1 || config.start_attempts > 10)
    return InvalidError("start_attempts is " + std::to_string(config.start_attempts) + ", needs 1 to 10");
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
  RG_RETURN_IF_ERROR(ReadFirstRollouts(root, &config));
  RG_RETURN_IF_ERROR(ReadArm(root, folder, &config));  // whatever the driver is
  RG_RETURN_IF_ERROR(ReadFence(root, &config));
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
  if (own) {
    config.own = {root.value(driver, json::object()).dump(), folder, config.name};
    return config;
  }
  if (config.driver != "simulated")
    return InvalidError("driver is \"" + config.driver + "\", needs simulated, kinova or replay" +
                        (RegisteredDrivers().empty() ? "" : ", or " + RegisteredDrivers()));
  RG_RETURN_IF_ERROR(ReadSimulated(root.at("simulated"), folder, &config.simulated));
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
  if (config.driver == "kinova") return kinova::MakeKinovaDriver(config.kinova);
  if (config.driver == "replay")
    return std::unique_ptr<Driver>(std::make_unique<ReplayDriver>(config.replay));
  if (const DriverMaker* maker = FindDriver(config.driver)) return (*maker)(config.own);
  SimulatedDriverOptions options = config.simulated;
  options.seed = robot_seed;
  return std::unique_ptr<Driver>(std::make_unique<SimulatedDriver>(std::move(options)));
}

}  // namespace rg::robot_agent
