// The safety monitor: a pure state machine that says, tick by tick, whether the arm may go on, and how its
// motion ends. It covers moves in position mode (homing, settling), the first torque, and the rollout:
//
//   moving (OnMove) --(any trip)-------------------------------------------> hold (position mode)
//   entering (CheckFirst) --(any trip)--> nothing was sent
//   running (OnTick) --(any trip, or time is up)--> zero torque --(zero_torque_s)--> hold
//                                              \--(state lost, absurd)-------^
//
// The first cause is kept; nothing leads back to running. Velocities are differenced here, from positions and
// their stamps: what the arm says of its velocity is only checked to be a number. No clock, no I/O, no
// allocation: whoever calls it (control_loop.cc, watched_move.cc) reads the clock, sends and records. One
// thread.
#pragma once

#include <cstdint>
#include <limits>
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
  kModeLost = 14,        // the arm left torque mode by itself
  kInterrupted = 15,     // the recording process died; found when the recording was salvaged
  kNotStarted = 16,      // the start pose or torque mode was not reached
  kFrozenState = 17,     // stamps advance, positions do not, and the arm should be moving
  kControllerHung = 18,  // no command came in time (guard/guard.h)
  kSelfCollision = 19,   // parts of the arm that have to stay apart overlap
};
std::string_view EndReasonName(EndReason reason);    // "completed", "position_limit", …
EndReason EndReasonFromName(std::string_view name);  // kNone if unknown

// What the loop knows at a tick before a command is computed.
struct Observation {
  int64_t now_ns = 0;
  bool connected = true;            // false: the driver lost the arm
  bool has_state = false;           // `state` was read at least once
  RobotState state;                 // the newest one
  const double* tip = nullptr;      // 3, end effector at state.q, base frame; null: not computed
  const double* gravity = nullptr;  // n, torque that holds the arm at state.q; null: not computed
  double clearance = std::numeric_limits<double>::infinity();  // see ArmModel::Clearance
  int nearest_pair = -1;
  int missed = 0;  // deadlines missed since the last tick (0: on time)
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
  int joint = -1;  // -1: none in particular; task box: 0, 1, 2 = x, y, z; parts: the pair
  double value = 0.0, limit = 0.0;
  int64_t at_ns = 0;
};

class SafetyMonitor {
 public:
  static constexpr double kOutsideSlack = 0.02;  // rad (m), of noise and control error
  // In position mode the arm keeps its own speed limits: a state may be so many times as old.
  static constexpr double kMovePatience = 4.0;
  // A joint that moved faster than this cannot stand still within one measurement, unless something holds it.
  static constexpr double kClearlyMoving = 0.2;  // rad/s (m/s)
  // A command that differs from gravity by this share of the torque limit should move something.
  static constexpr double kClearPush = 0.5;

  // `limits` must have passed ValidateLimits for n joints. `period_s`: of the control cycle; a command may
  // differ from the one before by at least torque_rate times this.
  SafetyMonitor(const SafetyLimits& limits, int n, double period_s = 0.0);

  // Position mode. `under_way`: the arm was told to move and has not arrived. kCommand: go on; otherwise
  // kHold. An arm that begins outside a box may come back into it, but go no further out (by kOutsideSlack).
  Action OnMove(const Observation& seen, bool under_way);
  // In position mode, before torque mode: may the arm be handed `tau` (n, gravity included) as its first
  // torque? It is not limited but refused beyond ±torque. kCommand: enter; otherwise it tripped.
  Action CheckFirst(const Observation& seen, const double* tau);
  // Torque mode.
  Action OnTick(const Observation& seen);
  // Only after OnTick returned kCommand. tau (n), in place: limited to ±torque and to torque_rate since the
  // last one, but for what only comes nearer to `gravity` (n, may be null). kCommand: send it; otherwise it
  // tripped (NaN, far beyond the limit) and tau must not be sent.
  Action LimitCommand(double* tau, const double* gravity, int64_t now_ns);

  // n, differenced over velocity_window_s; false: too few positions were seen.
  bool Velocity(double* v) const;
  const Trip& trip() const { return trip_; }
  uint64_t saturated_samples() const { return saturated_; }
  uint64_t ticks() const { return ticks_; }

 private:
  enum class Phase : uint8_t { kRunning, kZeroTorque, kHold };
  static constexpr int kHistory = 64;
  struct Position {
    int64_t stamp_ns = 0;
    JointArray q{};
  };

  void CheckEverything(const Observation& seen, Mode expected);
  void Remember(const RobotState& state);
  const Position& Past(int back) const;  // 0: the newest
  void UpdateVelocity();
  void CheckFrozen(const Observation& seen);
  void WidenToStart(const Observation& seen);
  double PushShare(const double* tau, const double* gravity) const;
  void CheckLiveness(const Observation& seen, Mode expected);
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
  const double period_s_;
  Phase phase_ = Phase::kRunning;
  Trip trip_;
  bool has_previous_ = false;
  RobotState previous_;
  Position history_[kHistory];
  int remembered_ = 0, newest_ = 0;
  JointArray velocity_{};
  bool has_velocity_ = false;
  int64_t frozen_since_ns_ = 0;     // stamp of the first of the equal positions
  double speed_before_freeze_ = 0;  // the largest of all joints
  bool told_to_move_ = false;
  int64_t told_since_ns_ = 0;
  // Moves only: how far out the arm may be, see OnMove.
  bool has_start_ = false;
  JointArray move_lower_{}, move_upper_{};
  double move_tip_lower_[3] = {}, move_tip_upper_[3] = {}, move_clearance_ = 0.0;
  bool moving_ = false;
  bool has_last_ = false;  // a command was allowed
  JointArray last_{};
  int64_t last_ns_ = 0;
  int consecutive_missed_ = 0;
  uint64_t saturated_ = 0, ticks_ = 0, missed_ = 0;
  int64_t first_tick_ns_ = 0;
};

// "joint_2: position 5.41 above its limit 5.36"; empty for a reason without a figure.
std::string DescribeTrip(const Trip& trip, const std::vector<std::string>& joints);

}  // namespace rg::robot_agent
