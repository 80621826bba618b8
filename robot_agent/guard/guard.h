// The fence as a process of its own: it alone talks to the arm. The agent asks (guard_protocol.h), the guard
// judges with its own limits and its own arm, sends, and gives states back. It stops the arm by itself (zero
// added torque, then StopArm) when
//
//   a state, a first torque or a command is not allowed             the monitor's reasons
//   no command came for 1.75 periods of the control cycle           controller_hung
//   somebody asks for it by a means of the driver's own           operator_stop
//   nobody asked for half a second while the arm is on its way      controller_hung
//   the agent's process is gone                                     driver_lost is what its successor would
//   see
//
// An entry into torque mode, which takes seconds where the arm has to prove it, is judged state by state as a move is,
// and ends when the agent says anything meanwhile, or is gone.
//
// After a stop it refuses everything but ReadState, SleepUntil and Hold until the next StartMove. If the agent is
// gone, it sees to the latch: taken away if the arm was seen at rest, else set. In lock-step the robot's time
// stands still while nobody asks, so nothing hangs.
//
// Knows the driver, limits, monitor, stop and latch; no controller, policy or job. One thread.
#pragma once

#include <memory>
#include <string>

#include "robot_agent/drivers/driver.h"
#include "robot_agent/drivers/packet_socket.h"
#include "robot_agent/guard/guard_protocol.h"
#include "robot_agent/safety/arm.h"
#include "robot_agent/safety/limits.h"
#include "robot_agent/safety/monitor.h"
#include "robot_agent/safety/stop.h"

namespace rg::robot_agent {

struct GuardOptions {
  std::string latch_folder;    // empty: the agent's own business only
  // So that the arm has its zero torque before two periods are over, though the guard wakes up a little late: a
  // quarter of a period is left for that.
  double hang_periods = 1.75;
  double first_periods = 5.0;  // for the first command: a controller may have to wake up
  double move_silence_s = 0.5;
  StopOptions stop;
};

class Guard {
 public:
  Guard(Driver& driver, ArmModel& arm, const SafetyLimits& limits, const PacketSocket& socket,
        const GuardOptions& options);

  // Serves until the agent says bye or is gone; then the arm is at rest, or latched.
  void Run();
  const Trip& trip() const { return trip_; }
  const StopReport& last_stop() const { return stop_; }
  // From the agent's last word to the zero torque of the last stop, s; negative: it had none.
  double zero_torque_after_s() const { return zero_torque_after_s_; }

 private:
  void Answer(const GuardMessage& request);
  void Connect(const GuardMessage& request, GuardMessage* reply);
  Status ReadState(GuardMessage* reply);
  Status StartMove(const GuardMessage& request);
  Status Enter(const GuardMessage& request);
  Status EnterUnlessStopped(const double* first);
  Status JudgeEntry(SafetyMonitor& monitor);
  Status Torque(const GuardMessage& request);
  Status Hold();
  Status Refused() const;
  double MostSilence() const;
  double Patience() const;
  std::string LatchedMotion() const;
  bool Look();  // reads the state into seen_; false: lost
  void Raise(EndReason reason);
  void Stop();
  void LeaveAlone();

  Driver& driver_;
  ArmModel& arm_;
  const SafetyLimits& limits_;
  const PacketSocket& socket_;
  const GuardOptions options_;
  const int n_;
  std::unique_ptr<SafetyMonitor> monitor_;
  enum class Doing { kNothing, kMoving, kTorque } doing_ = Doing::kNothing;
  Observation seen_;
  double tip_[3] = {};
  JointArray gravity_{}, target_{};
  double period_s_ = 0.0;
  int64_t last_word_ns_ = 0;  // machine's clock: the last command, or request in a move
  uint64_t sequence_ = 0;
  bool connected_ = false, stop_pending_ = false;
  bool under_way_ = false, commanded_ = false;
  bool stopped_it_ = false;  // the last motion was ended by the guard itself
  std::string motion_;  // the latch's entry when it began
  Trip trip_;
  StopReport stop_;
  double zero_torque_after_s_ = -1.0;
};

}  // namespace rg::robot_agent
