// Message definitions of ROS 1 and 2 (wiki.ros.org/msg, the text that bags and MCAP files hold) as types.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.h"

namespace rg::importing {

enum class Primitive : uint8_t {
  kInt8,
  kUint8,
  kInt16,
  kUint16,
  kInt32,
  kUint32,
  kInt64,
  kUint64,
  kFloat32,
  kFloat64,
  kString,
  kWideString,
  kTime,      // ROS 1: seconds and nanoseconds as unsigned 32 bits each
  kDuration,  // ROS 1: the same, signed
  kMessage,   // none: the field is a message
};

struct FieldType {
  std::string name;
  Primitive primitive = Primitive::kMessage;
  size_t message = 0;  // index into MessageTypes::messages, for kMessage
  enum class Array : uint8_t { kNone, kFixed, kVariable } array = Array::kNone;
  uint32_t count = 0;  // of a fixed array
};

struct MessageType {
  std::string name;  // "sensor_msgs/JointState"
  std::vector<FieldType> fields;
};

// messages[0] is the type itself; what it is made of follows. No type contains itself.
struct MessageTypes {
  std::vector<MessageType> messages;
  const MessageType& root() const { return messages.front(); }
};

// `type` as in Topic::type. `text` is the definition with those it needs behind lines of '=', as in a bag;
// empty: one of the types that this program knows by itself (old ROS 2 bags hold no definitions), as
// ROS 2 or ROS 1 has it. Constants and defaults are read over.
Result<MessageTypes> ParseDefinition(const std::string& type, std::string_view text, bool ros2);

// The definition of a type known by itself, with what it needs, as a bag holds it; empty if unknown.
// `ros2`: std_msgs/Header has no seq, times are builtin_interfaces.
std::string KnownDefinition(const std::string& type, bool ros2);

// Seconds and nanoseconds, of either ROS.
bool IsTime(const MessageTypes& types, const FieldType& field);

}  // namespace rg::importing
