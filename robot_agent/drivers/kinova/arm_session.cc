#include "robot_agent/drivers/kinova/arm_session.h"

#include <unistd.h>

#include <nlohmann/json.hpp>

#include "common/base/file.h"

namespace rg::robot_agent::kinova {
namespace {

using nlohmann::json;

constexpr char kFormat[] = "realitygrad.arm_session/1";

std::string BootId() {
  const auto id = ReadFile("/proc/sys/kernel/random/boot_id");
  return id.ok() ? id->substr(0, id->find('\n')) : "";
}

ArmSession Parse(const json& root) {
  ArmSession session;
  root.at("prepared_ns").get_to(session.prepared_ns);
  root.at("arm").get_to(session.arm);
  root.at("number").get_to(session.number);
  for (const json& joint : root.at("joints"))
    session.responses.push_back({joint.at("torque_nm"), joint.at("drift_rad_per_s")});
  return session;
}

}  // namespace

std::optional<ArmSession> SessionFile::Read() const {
  if (path_.empty()) return std::nullopt;
  const auto text = ReadFile(path_);
  if (!text.ok()) return std::nullopt;
  try {
    const json root = json::parse(*text);
    const std::string boot = BootId();
    if (root.at("format") != kFormat || boot.empty() || root.at("boot") != boot) return std::nullopt;
    return Parse(root);
  } catch (const json::exception&) {
    return std::nullopt;
  }
}

Status SessionFile::Write(const ArmSession& session) const {
  if (path_.empty()) return Status::Ok();
  json joints = json::array();
  for (const auto& joint : session.responses)
    joints.push_back({{"torque_nm", joint.torque_nm}, {"drift_rad_per_s", joint.drift_rad_per_s}});
  return WriteFileAtomically(path_, json{{"format", kFormat},
                                         {"boot", BootId()},
                                         {"prepared_ns", session.prepared_ns},
                                         {"arm", session.arm},
                                         {"number", session.number},
                                         {"joints", joints}}
                                            .dump() +
                                        "\n");
}

void SessionFile::Forget() const {
  if (!path_.empty()) unlink(path_.c_str());
}

bool Holds(const ArmSession& session, const std::string& arm, uint32_t number, int64_t now_ns,
           double at_most_s) {
  const double age = 1e-9 * static_cast<double>(now_ns - session.prepared_ns);
  return session.arm == arm && number >= session.number && age >= 0.0 && age <= at_most_s;
}

}  // namespace rg::robot_agent::kinova
