// Drivers beside the built-in ones, by the name that a configuration's "driver" says. A program for another arm
// registers its own before anything else; realitygrad-agent and realitygrad-guard are then its own too.
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "common/base/status.h"
#include "robot_agent/drivers/driver.h"

namespace rg::robot_agent {

// `options`: the configuration's object of the driver's name as JSON text, "{}" if it has none. Refuses what it does
// not understand, in one line. `folder` resolves relative paths; `robot` is the agent's name of the arm.
struct DriverRequest {
  std::string options, folder, robot;
};
using DriverMaker = std::function<Result<std::unique_ptr<Driver>>(const DriverRequest& request)>;

// Once per name, from main.
void RegisterDriver(const std::string& name, DriverMaker maker);
// Null: nobody registered it.
const DriverMaker* FindDriver(const std::string& name);
// "mine, yours"; empty: none.
std::string RegisteredDrivers();

}  // namespace rg::robot_agent
