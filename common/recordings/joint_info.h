// What readers and checks of recordings want to know of a joint of the robot.
#pragma once

#include <limits>
#include <string>

namespace rg::recordings {

struct JointInfo {
  enum class Type { kRevolute, kContinuous, kPrismatic };
  std::string name;
  Type type = Type::kRevolute;
  double lower = -std::numeric_limits<double>::infinity();  // rad or m
  double upper = std::numeric_limits<double>::infinity();
  double velocity = std::numeric_limits<double>::infinity();  // rad/s or m/s
};

}  // namespace rg::recordings
