#include "robot_agent/agent_config.h"

#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "common/base/json_fields.h"
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

Status ReadSimulated(const json& object, const std::string& folder, SimulatedDriverOptions* options) {
  JsonFields fields(object, "truth lock_step socket program reply_timeout_s", "simulated: ");
  fields.Read("truth", &options->truth_path);
  fields.Read("socket", &options->socket_path);
  fields.Read("program", &options->program);
  fields.Read("lock_step", &options->lock_step);
  fields.Read("reply_timeout_s", &options->reply_timeout_s);
  options->truth_path = Resolve(folder, options->truth_path);
  if (options->truth_path.empty() && options->socket_path.empty())
    fields.Fail("needs \"truth\" or \"socket\"");
  return fields.status();
}

Status ReadReplay(const json& object, const std::string& folder, ReplayOptions* options) {
  JsonFields fields(object, "set recording lock_step", "replay: ");
  fields.Require("set", &options->folder);
  fields.Read("recording", &options->recording);
  fields.Read("lock_step", &options->lock_step);
  options->folder = Resolve(folder, options->folder);
  return fields.status();
}

Status ReadArm(JsonFields& fields, const std::string& folder, AgentConfig* config) {
  std::string urdf;
  fields.Require("urdf", &urdf, "the arm's own kinematics and gravity, which no job's model replaces");
  model::LoadOptions options;
  fields.Read("joints", &options.joints);
  fields.Read("locked", &options.locked);
  fields.Read("end_effector", &options.end_effector);
  fields.Read("gravity", &config->gravity);
  if (config->gravity.size() != 3) fields.Fail("gravity needs three numbers");
  RG_RETURN_IF_ERROR(fields.status());
  RG_ASSIGN_OR_RETURN(auto arm, model::LoadUrdf(Resolve(folder, urdf), options));
  if (arm.num_joints() > kMaxJoints)
    return InvalidError("urdf: " + std::to_string(arm.num_joints()) + " joints, at most " +
                        std::to_string(kMaxJoints));
  config->arm = std::make_shared<const model::RobotModel>(std::move(arm));
  return Status::Ok();
}

void ReadPoint(JsonFields& fields, const char* field, Eigen::Vector3d* point) {
  std::vector<double> read;
  fields.Require(field, &read);
  if (read.size() != 3) return fields.Fail(std::string(field) + " needs three numbers");
  *point = Eigen::Map<const Eigen::Vector3d>(read.data());
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
    Capsule part;
    JsonFields fields(object, "name link from to radius", "capsules: " + object.value("name", "") + ": ");
    fields.Require("name", &part.name);
    fields.Require("link", &part.link);
    ReadPoint(fields, "from", &part.from);
    ReadPoint(fields, "to", &part.to);
    fields.Positive("radius", &part.radius);
    RG_RETURN_IF_ERROR(fields.status());
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
  JsonFields fields(root["first_rollouts"], "duration_s speed", "first_rollouts: ");
  fields.Require("duration_s", &first.duration_s);
  fields.Require("speed", &first.speed);
  fields.Positive("duration_s", &first.duration_s);
  fields.Positive("speed", &first.speed, 1);
  return fields.status();
}

Result<AgentConfig> Read(const json& root, const std::string& folder) {
  const std::string driver = root.value("driver", "simulated");
  const bool own = FindDriver(driver) != nullptr;
  JsonFields fields(
      root,
      "format name driver simulated kinova replay start_pose pose_tolerance pose_timeout_s settle_s "
      "connect_timeout_s start_attempts limits velocity_source excitation urdf joints locked "
      "end_effector gravity max_rate_hz max_duration_s min_free_mb first_rollouts capsules apart" +
          (own ? " " + driver : ""));
  fields.Format("realitygrad.agent/1");
  AgentConfig config;
  config.driver = driver;
  std::string source = "measured";
  fields.Require("name", &config.name);
  fields.Require("start_pose", &config.start_pose);
  fields.Positive("pose_tolerance", &config.pose_tolerance);
  fields.Positive("pose_timeout_s", &config.pose_timeout_s);
  fields.Read("settle_s", &config.settle_s);
  fields.Read("connect_timeout_s", &config.connect_timeout_s);
  fields.Number("start_attempts", 1, 10, &config.start_attempts);
  fields.Positive("max_rate_hz", &config.max_rate_hz);
  fields.Positive("max_duration_s", &config.max_duration_s);
  fields.Positive("min_free_mb", &config.min_free_mb);
  fields.Number("excitation", 0, 1, &config.excitation);
  fields.Read("velocity_source", &source);
  if (source != "measured" && source != "differenced")
    fields.Fail("velocity_source is \"" + source + "\", needs measured or differenced");
  RG_RETURN_IF_ERROR(fields.status());
  config.velocity_source = source == "measured" ? VelocitySource::kMeasured : VelocitySource::kDifferenced;
  RG_RETURN_IF_ERROR(ReadFirstRollouts(root, &config));
  RG_RETURN_IF_ERROR(ReadArm(fields, folder, &config));  // whatever the driver is
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
