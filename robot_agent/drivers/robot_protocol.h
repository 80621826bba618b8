// The messages between the simulated robot's process and its driver: packets of a Unix socket
// (SOCK_SEQPACKET), one message each, of one fixed size, native little-endian. Version 1.
//
// Time. In real time both sides use CLOCK_MONOTONIC. In lock-step the robot's time starts at zero and
// passes only while it serves an Advance.
//
//   driver -> robot                         robot -> driver
//   Hello    flags & kLockStep              Info (text: JSON of InfoToJson)
//   EnterTorque a = first torque            Ack  (a refusal is silent: only the mode of later states tells)
//   Torque   a = torque                     -
//   Hold                                    Ack
//   MoveTo   a = q                          Ack; later states carry kMoving until there
//   Advance  time_ns = until (lock-step)    Advanced with the newest state delivered by then
//   -                                       State, as measured (real time)
//   Fault    code, a[0] = strength          - (tests only, needs --allow-faults)
//   Bye                                     - (the robot's process ends)
#pragma once

#include <bit>
#include <cstdint>
#include <string>

#include "common/base/status.h"
#include "robot_agent/drivers/driver.h"

namespace rg::robot_agent {

static_assert(std::endian::native == std::endian::little);

inline constexpr uint32_t kProtocolMagic = 0x31425247;  // "GRB1"
inline constexpr uint16_t kProtocolVersion = 1;

enum class MessageType : uint16_t {
  kHello = 1,
  kInfo = 2,
  kEnterTorque = 3,
  kTorque = 4,
  kHold = 5,
  kMoveTo = 6,
  kAdvance = 7,
  kAdvanced = 8,
  kState = 9,
  kAck = 10,
  kFault = 11,
  kBye = 12,
};

// What a test may ask of the simulated robot.
enum class Fault : uint16_t {
  kNone = 0,
  kFreeze = 1,        // the process stops answering (and, in real time, its time passes without it)
  kDropReplies = 2,   // messages are served, nothing is sent back
  kNan = 3,           // the measured position of joint 0 is NaN from now on
  kJump = 4,          // the measured positions are off by a[0] rad from now on
  kDie = 5,           // the process exits at once
  kRefuseTorque = 6,  // EnterTorque is acknowledged and ignored
  kLeaveTorque = 7,   // the arm falls back to position mode by itself
};

struct RobotMessage {
  static constexpr uint16_t kLockStep = 1, kMoving = 2, kHasState = 4;

  uint32_t magic = kProtocolMagic;
  uint16_t version = kProtocolVersion;
  MessageType type = MessageType::kHello;
  uint64_t sequence = 0;  // of the state, or of the request that is acknowledged
  int64_t time_ns = 0;
  int64_t stamp_ns = 0;
  uint32_t joints = 0;
  Mode mode = Mode::kPosition;
  uint16_t flags = 0;
  uint16_t code = 0;
  uint16_t reserved[3] = {};
  JointArray a{}, b{}, c{};  // State: q, v, effort
};
static_assert(sizeof(RobotMessage) == 48 + 3 * 8 * kMaxJoints);

// Info has text behind the fixed part.
inline constexpr size_t kMaxInfoText = 8192;

// Right size, magic and version, at most kMaxJoints joints; the message says what is wrong.
Status CheckMessage(const RobotMessage& message, size_t bytes);

std::string InfoToJson(const DriverInfo& info);
Result<DriverInfo> InfoFromJson(const std::string& json);

}  // namespace rg::robot_agent
