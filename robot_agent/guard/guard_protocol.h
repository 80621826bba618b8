// Between the agent (guard_driver.h) and the guard (guard.h): packets of a Unix socket, one request, one
// reply, of one fixed size, native byte order; both are of the same build. A command carries a sequence
// number and a deadline in the driver's time: one that comes later than that, or twice, is not sent to the
// arm.
#pragma once

#include <cstdint>

#include "common/base/status.h"
#include "robot_agent/drivers/driver.h"
#include "robot_agent/safety/monitor.h"

namespace rg::robot_agent {

inline constexpr uint32_t kGuardMagic = 0x32475247;  // "GRG2"

enum class GuardRequest : uint32_t {
  kConnect = 1,  // number = time-out; the reply is followed by a packet with InfoToJson
  kReadState = 2,
  kSleepUntil = 3,  // time_ns; lock-step only
  kStartMove = 4,   // values = q
  kEnter = 5,       // values = first torque handed, number = period of the control cycle
  kTorque = 6,      // values = torque handed, sequence, deadline_ns
  kHold = 7,
  kBye = 8,
  kMoveEnd = 9,
  kStopEntry = 10,  // while kEnter is under way, which then ends; no reply of its own
};

struct GuardMessage {
  uint32_t magic = kGuardMagic;
  GuardRequest request = GuardRequest::kBye;
  uint64_t sequence = 0;
  int64_t deadline_ns = 0, time_ns = 0;  // in a reply, time_ns is the driver's now
  double number = 0.0;
  JointArray values{};
  // Of a reply.
  StatusCode code = StatusCode::kOk;
  RobotState state;
  Trip trip;  // what the guard stopped the arm for; kNone: nothing so far
  char text[400] = {};
};

}  // namespace rg::robot_agent
