#include "robot_agent/drivers/driver_registry.h"

#include <map>

#include "common/base/check.h"

namespace rg::robot_agent {
namespace {

std::map<std::string, DriverMaker>& Makers() {
  static std::map<std::string, DriverMaker> makers;
  return makers;
}

}  // namespace

void RegisterDriver(const std::string& name, DriverMaker maker) {
  RG_CHECK(Makers().emplace(name, std::move(maker)).second) << "driver " << name << " is there twice";
}

const DriverMaker* FindDriver(const std::string& name) {
  const auto found = Makers().find(name);
  return found == Makers().end() ? nullptr : &found->second;
}

std::string RegisteredDrivers() {
  std::string names;
  for (const auto& [name, maker] : Makers()) names += (names.empty() ? "" : ", ") + name;
  return names;
}

}  // namespace rg::robot_agent
