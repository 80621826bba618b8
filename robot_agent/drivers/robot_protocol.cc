#include "robot_agent/drivers/robot_protocol.h"

#include <nlohmann/json.hpp>

namespace rg::robot_agent {

Status CheckMessage(const RobotMessage& message, size_t bytes) {
  if (bytes < sizeof(RobotMessage))
    return InvalidError("robot message of " + std::to_string(bytes) + " bytes, needs " +
                        std::to_string(sizeof(RobotMessage)));
  if (message.magic != kProtocolMagic) return InvalidError("robot message with a wrong magic number");
  if (message.version != kProtocolVersion)
    return InvalidError("robot message of protocol version " + std::to_string(message.version) +
                        ", this is " + std::to_string(kProtocolVersion));
  if (message.joints > kMaxJoints)
    return InvalidError("robot message with " + std::to_string(message.joints) + " joints, limit " +
                        std::to_string(kMaxJoints));
  return Status::Ok();
}

std::string InfoToJson(const DriverInfo& info) {
  return nlohmann::json{{"robot", info.robot},
                        {"joints", info.joints},
                        {"adds_gravity_compensation", info.adds_gravity_compensation},
                        {"silence_timeout_s", info.silence_timeout_s},
                        {"state_rate_hz", info.state_rate_hz},
                        {"position_stddev", info.position_stddev},
                        {"velocity_stddev", info.velocity_stddev},
                        {"position_resolution", info.position_resolution}}
      .dump();
}

Result<DriverInfo> InfoFromJson(const std::string& text) {
  try {
    const auto root = nlohmann::json::parse(text);
    DriverInfo info;
    root.at("robot").get_to(info.robot);
    root.at("joints").get_to(info.joints);
    root.at("adds_gravity_compensation").get_to(info.adds_gravity_compensation);
    root.at("silence_timeout_s").get_to(info.silence_timeout_s);
    root.at("state_rate_hz").get_to(info.state_rate_hz);
    root.at("position_stddev").get_to(info.position_stddev);
    root.at("velocity_stddev").get_to(info.velocity_stddev);
    root.at("position_resolution").get_to(info.position_resolution);
    if (info.joints.empty() || info.joints.size() > kMaxJoints)
      return InvalidError("the robot announces " + std::to_string(info.joints.size()) + " joints, limit " +
                          std::to_string(kMaxJoints));
    return info;
  } catch (const nlohmann::json::exception& error) {
    return InvalidError(std::string("the robot's announcement: ") + error.what());
  }
}

}  // namespace rg::robot_agent
