// The safety monitor: a pure state machine that says, tick by tick, whether the controller's
// command may go out, and how the rollout ends.
//
//   running --(any trip, or time is up)--> zero torque --(zero_torque_s)--> hold (position mode)
//                                              \--(state lost, absurd)-------^
//
// The first cause is kept; nothing leads back to running. No clock, no I/O, no allocation: whoever
// calls it (control_loop.cc) reads the clock, sends and records. One thread.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "robot_agent/drivers/driver.h"
#include "robot_agent/safety/limits.h"

namespace rg::robot_agent {

// Why a rollout ended. The numbers are stored in recordings: append only.
enum class EndReason : uint16_t {
  kNone = 0,  // not ended
  kCompleted = 1,
  kPositionLimit = 2,
  kVelocityLimit = 3,
  kTorqueLimit = 4,  // the controller asked for more than torque_trip_ratio allows
  kTaskSpaceLimit = 5,
  kControllerNan = 6,
  kRobotNan = 7,
  kStaleState = 8,
  kImpossibleState = 9,  // a jump, or a stamp that goes back or lies ahead
  kMissedDeadlines = 10,
  kDriverLost = 11,
  kOperatorStop = 12,
  kRecorderFailed = 13,
  kModeLost = 14,     // the arm left torque mode by itself
  kInterrupted = 15,  // the recording process died; found when the recording was salvaged
  kNotStarted = 16,   // the start pose or torque mode was not reached
};
std::string_view EndReasonName(EndReason reason);    // "completed", "position_limit", …
EndReason EndReasonFromName(std::string_view name);  // kNone if unknown

// What the loop knows at a tick before a command is computed.
struct Observation {
  int64_t now_ns = 0;
  bool connected = true;        // false: the driver lost the arm
  bool has_state = false;       // `state` was read at least once
  RobotState state;             // the newest one
  const double* tip = nullptr;  // 3, end effector at state.q, base frame; null: not computed
  int missed = 0;               // deadlines missed since the last tick (0: on time)
  bool operator_stop = false;
  bool recorder_ok = true;
  bool time_up = false;
};

enum class Action : uint8_t {
  kCommand,    // running: compute the command, pass it through LimitCommand, send it
  kZeroAdded,  // send zero added torque (gravity compensation at state.q, or 0 if the base adds it)
  kHold,       // position mode now; the rollout is over
};

struct Trip {
  EndReason reason = EndReason::kNone;
  int joint = -1;  // -1: none in particular; for the task box 0, 1, 2 = x, y, z
  double value = 0.0, limit = 0.0;
  int64_t at_ns = 0;
};

class SafetyMonitor {
 public:
  // `limits` must have passed ValidateLimits for n joints.
  SafetyMonitor(const SafetyLimits& limits, int n);

  Action OnTick(const Observation& seen);
  // Only after OnTick returned kCommand. tau (n), in place: limited to ±torque. kCommand: send it;
  // otherwise it tripped (NaN, far beyond the limit) and tau must not be sent.
  Action LimitCommand(double* tau, int64_t now_ns);

  const Trip& trip() const { return trip_; }
  uint64_t saturated_samples() const { return saturated_; }
  uint64_t ticks() const { return ticks_; }
  uint64_t missed() const { return missed_; }

 private:
  enum class Phase : uint8_t { kRunning, kZeroTorque, kHold };

  void CheckEverything(const Observation& seen);
  void CheckLiveness(const Observation& seen);
  void CheckStamp(const Observation& seen);
  void CheckFinite(const Observation& seen);
  void CheckJump(const Observation& seen);
  void CheckBoxes(const Observation& seen);
  void CheckDeadlines(const Observation& seen);
  void Raise(const Observation& seen, EndReason reason, int joint = -1, double value = 0, double limit = 0);
  bool StateUsable(const Observation& seen) const;
  Action AfterTrip(const Observation& seen);

  const SafetyLimits& limits_;
  const int n_;
  Phase phase_ = Phase::kRunning;
  Trip trip_;
  bool has_previous_ = false;
  RobotState previous_;
  int consecutive_missed_ = 0;
  uint64_t saturated_ = 0, ticks_ = 0, missed_ = 0;
  int64_t first_tick_ns_ = 0;
};

// "joint_2: position 5.41 above its limit 5.36"; empty for a reason without a figure.
std::string DescribeTrip(const Trip& trip, const std::vector<std::string>& joints);

}  // namespace rg::robot_agent
