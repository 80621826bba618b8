// One robot arm as the control loop sees it. A driver hides how the arm is reached (a socket, ROS)
// and in what units and quirks; everything here is SI, in the joint order of info().joints.
//
// Who calls it, from which thread: one thread, the one that runs the rollout. A driver may have
// threads of its own behind it. NowNanos, SleepUntil, ReadState, SendTorque and Hold are called in
// the control cycle: they allocate nothing, take no lock that another thread holds for long, and never
// wait longer than the time-out given at Connect.
//
// Torque convention. A command is the *whole* joint torque a controller asks of the drive, gravity
// included. An arm whose base adds its own gravity compensation to what it receives (Kinova's torque
// mode, info().adds_gravity_compensation) is handed the difference command - g(q) by the caller, see
// control_loop.h: drivers pass on what they get and add or subtract nothing.
//
// Time. Every stamp and deadline is in the driver's own time base, NowNanos(). A driver on a
// real arm uses the machine's steady clock; one that runs its robot in lock-step uses the robot's
// time, and SleepUntil is what lets that time pass.
//
// What an implementation for an arm like the Kinova has to provide (docs of the robot):
//  - mode changes that are refused in silence must be found out by the driver (does the arm accept
//    and follow the torque?) and reported as kFailedPrecondition by EnterTorqueMode;
//  - a state whose velocity is unreliable carries what the arm said; the caller chooses
//    (ControlLoopOptions::velocity_source) whether to use it or to difference positions;
//  - silence longer than info().silence_timeout_s puts the arm at zero added torque or in position mode;
//  - degrees, turns and wrapped angles end inside the driver.
//
// Errors. kUnavailable is an outage and nothing else (IsOutage): no state arrives, the arm's driver or its master is
// not there. An arm that is there and does not do what it was asked has refused, whatever the cause:
// kFailedPrecondition. Only an outage is waited for and tried again.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "common/base/progress.h"
#include "common/base/status.h"

namespace rg::robot_agent {

inline constexpr int kMaxJoints = 16;
// What a call takes at the most, s: entering torque mode, where an arm may have to be asked and tested several times;
// any other one (Hold of an arm whose services hang). Who waits for an arm waits for this.
inline constexpr double kLongestEntry = 40.0;
inline constexpr double kLongestCall = 15.0;

using JointArray = std::array<double, kMaxJoints>;  // the first n entries count

enum class Mode : uint16_t { kPosition = 0, kTorque = 1 };

struct RobotState {
  int64_t stamp_ns = 0;   // when the positions were measured, driver's time base
  uint64_t sequence = 0;  // grows by at least one with every measurement
  Mode mode = Mode::kPosition;
  bool moving = false;  // a MoveToPose is under way
  JointArray q{};       // rad (m)
  JointArray v{};       // rad/s (m/s)
  JointArray effort{};  // measured, N·m (N)
};

struct DriverInfo {
  std::string robot;                // "mico2"
  std::string driver;               // "simulated", "kinova"
  std::vector<std::string> joints;  // n names
  bool adds_gravity_compensation = false;
  bool lock_step = false;
  double silence_timeout_s = 0.25;
  double state_rate_hz = 0.0;
  // What the data sheet says of the sensors; negative = unknown.
  double position_stddev = -1.0, velocity_stddev = -1.0, position_resolution = -1.0;
};

struct DriverHealth {
  bool connected = false;
  uint64_t states_received = 0, states_lost = 0;  // lost: gaps in the sequence
  uint64_t commands_sent = 0, malformed = 0;
  std::string last_error;
};

// A call failed because the arm was away: it may be asked again when it is back.
inline bool IsOutage(const Status& status) { return status.code() == StatusCode::kUnavailable; }

class Driver {
 public:
  virtual ~Driver() = default;

  // Reaches the arm and learns info(); kDeadlineExceeded if it is there and does not answer. After an outage it may
  // be called again.
  virtual Status Connect(double timeout_s) = 0;
  virtual const DriverInfo& info() const = 0;  // valid after Connect
  virtual DriverHealth health() const = 0;

  virtual int64_t NowNanos() const = 0;
  // Returns at or after `deadline_ns`; kUnavailable if the robot was lost meanwhile.
  virtual Status SleepUntil(int64_t deadline_ns) = 0;

  // The newest measured state (possibly one already seen: compare `sequence`). kUnavailable: none yet,
  // or the connection is gone.
  virtual Status ReadState(RobotState* state) = 0;

  // Position mode -> torque mode with `first` (n) as the command in force from the first instant.
  // kFailedPrecondition: the arm did not enter it. kCancelled: whoever is heeded (HeedStop) asked for a stop meanwhile;
  // what comes next is Hold.
  virtual Status EnterTorqueMode(const double* first) = 0;
  // tau (n): what the arm is handed, see the convention above. Holds until the next command.
  virtual Status SendTorque(const double* tau) = 0;
  // The stop every end of a rollout comes to: position mode at the present position. Safe in any mode
  // and repeatedly; a lost arm gives kUnavailable (it then stops by its own silence timeout), one that goes on moving
  // kFailedPrecondition.
  virtual Status Hold() = 0;

  // Position mode; begins to ramp to q (n) within the arm's speed limits and returns as soon as the arm has
  // accepted it. States measured from then on carry `moving` until it is there and at rest; Hold ends it.
  // What an arm needs before its first motion (sensors zeroed, small test torques) is part of its first move,
  // `moving` throughout; its states may say torque mode meanwhile, and Hold ends that too. The agent moves
  // the arm by this call alone, with every state judged on the way (safety/watched_move.h): an arm whose
  // driver lacks it does not move.
  virtual Status StartMove(const double* q) {
    (void)q;
    return FailedPreconditionError("this driver cannot move to a pose while it is watched");
  }
  // How the last StartMove ended, once a state without `moving` was read after it: what the driver knows of a way
  // that it gave up. Ok: it knows of nothing.
  virtual Status MoveEnd() { return Status::Ok(); }
  // StartMove, returns when there (within `tolerance`, per joint) and at rest. kDeadlineExceeded, then the arm
  // holds where it is. Nobody watches: for trials by hand and tests.
  virtual Status MoveToPose(const double* q, double tolerance, double timeout_s);

  // What may take long (EnterTorqueMode) ends soon after `stop` was cancelled. Not owned; null: nobody is heeded. The
  // caller's thread, while no call is under way.
  void HeedStop(const CancelToken* stop) { stop_ = stop; }
  // Called in EnterTorqueMode with each state that arrives while the mode is proved; not ok ends that with its status.
  // Empty: nobody looks.
  using EntryWatch = std::function<Status()>;
  void WatchEntry(EntryWatch watch) { entry_watch_ = std::move(watch); }
  // Somebody beside the arm asked for a stop by a means of the driver's own, as a topic; it stays so.
  virtual bool StopWanted() const { return false; }

 protected:
  bool stop_asked() const { return stop_ != nullptr && stop_->cancelled(); }
  Status JudgeEntry() const { return entry_watch_ ? entry_watch_() : Status::Ok(); }

 private:
  EntryWatch entry_watch_;
  const CancelToken* stop_ = nullptr;
};

// Waits so long in the driver's time; by the machine's clock where a driver that lost its arm may not wait.
void Pause(Driver& driver, double seconds);

}  // namespace rg::robot_agent
