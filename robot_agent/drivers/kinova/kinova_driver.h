// A Kinova arm of the first generations (Mico², Jaco²) through kinova-ros, in torque mode.
//
//   Connect      master there -> states arrive, plausible, often enough -> torques are heard -> position mode
//                (an agent that died may have left the arm floating)
//   StartMove    the first time Prepare: position mode -> zero pose -> torque sensors zeroed and checked ->
//                torque mode proved -> test torque of every joint -> position mode; then the pose, by action.
//                Where a session before did all that (arm_session.h) the zero pose and the sensors are checked.
//                All of it in a thread of its own, `moving` throughout, ended by Hold
//   EnterTorqueMode   torque mode, proved by a test torque of one joint (a refusal is silent)
//   SendTorque   the command in force; a thread re-sends it at 100 Hz
//   Hold         zero added torque, position mode, confirmed by an arm that stands still
//
// info().adds_gravity_compensation is true: torques are added to the arm's own compensation.
//
// Threads: the caller's; the link's, which takes states; a move's; and the sender's. When the caller falls
// silent for command_timeout_s the sender sends zero added torque, half a second later it asks for position
// mode and stops. No state for outage_s: the arm is lost, every call says kUnavailable, nothing is sent (the
// arm then falls to zero added torque by itself); when states are back, the sender asks for position mode,
// and with that confirmed the driver is usable again, Prepare included.
#pragma once

#include <atomic>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "robot_agent/drivers/driver.h"
#include "robot_agent/drivers/driver_time.h"
#include "robot_agent/drivers/kinova/arm_link.h"
#include "robot_agent/drivers/kinova/arm_session.h"
#include "robot_agent/drivers/kinova/clock_map.h"
#include "robot_agent/drivers/kinova/kinova_options.h"
#include "robot_agent/drivers/kinova/motion_watch.h"
#include "robot_agent/drivers/kinova/rate_estimate.h"
#include "robot_agent/drivers/kinova/torque_probe.h"
#include "robot_agent/drivers/kinova/unwrapping.h"

namespace rg::robot_agent::kinova {

class KinovaDriver final : public Driver {
 public:
  KinovaDriver(KinovaOptions options, std::unique_ptr<ArmLink> link,
               std::shared_ptr<DriverTime> time = MachineTime());
  // Position mode first; where the arm is away, it is waited for up to options.farewell_s.
  ~KinovaDriver() override;

  Status Connect(double timeout_s) override;
  const DriverInfo& info() const override { return info_; }
  DriverHealth health() const override;
  int64_t NowNanos() const override;
  Status SleepUntil(int64_t deadline_ns) override;
  Status ReadState(RobotState* state) override;
  Status EnterTorqueMode(const double* first) override;
  Status SendTorque(const double* tau) override;
  Status Hold() override;
  Status StartMove(const double* q) override;
  Status MoveEnd() override;
  bool StopWanted() const override { return link_->StopAsked(); }
  Status MoveToPose(const double* q, double tolerance, double timeout_s) override;

  // Zero pose, sensors, test torques; a move calls it once per connection. `timeout_s` is for the way to
  // the zero pose.
  Status Prepare(double timeout_s);
  // Of the last Prepare, n.
  const std::vector<JointResponse>& responses() const { return responses_; }

 private:
  // Hold, of whoever calls: the move's own thread too.
  Status HoldNow();
  // Ends a move that is under way, and waits for its thread.
  void EndMove();
  Status CheckNotStopped() const;
  Status AwaitFirstState(double timeout_s);
  Status CheckRate(double timeout_s);
  Status AwaitHeard(double timeout_s);
  Status GoTo(const double* q, double tolerance, double timeout_s);
  bool GoOnWithSession();
  void KeepSession() const;
  uint32_t NewestNumber() const;
  Status ZeroSensors();
  Status CheckSensors();
  // The joint whose sensor reads most, over ten states.
  Status WorstEffort(int* joint, double* effort);
  Status TestAllJoints();
  // Torque mode with `first`, proved; where a joint does not answer, the next one is asked.
  Status EnterProved(const JointArray& first);
  // A refusal by silence is kFailedPrecondition with *silent set; any other error ends the attempt for good.
  Status TryTorqueMode(const JointArray& first, bool* silent, std::string* tested);
  Status TestJoint(int joint, const JointArray& base, ProbeEnd* end, double* reached, double* drift);
  // Returns a little after a state came. A control loop that begins then at the rate of the states finds a
  // new one at each of its ticks; begun anywhere, it would miss those that come a little late.
  Status AwaitPhase();
  Status JudgeTest(int joint, ProbeEnd end, double reached, double drift) const;
  // No joint leaves ± speed · for_s during for_s. kDeadlineExceeded: not within at_most_s. Part of every stop: only a
  // move that Hold ends is not waited for.
  Status AwaitStill(double speed, double for_s, double at_most_s);
  // Waits for a state newer than `sequence`.
  Status AwaitState(uint64_t sequence, double timeout_s, RobotState* state);
  Status PositionMode();
  Status Ask(ArmService service);
  // Of something that failed: an outage, if the arm is away now; else its refusal.
  Status RefusedOrAway(const Status& failed);

  void OnReport(const Result<JointReport>& report);
  void TakeReport(const JointReport& report);
  void Stream(const JointArray& tau, bool fresh);
  JointArray Command() const;
  void StopStream();
  void SendForEver();
  void SendOnce(int64_t now_ns);
  void WatchLink(int64_t now_ns);
  Status LostError() const;

  const KinovaOptions options_;
  const std::shared_ptr<DriverTime> time_;
  const SessionFile session_;
  const std::vector<std::string> ros_names_;
  DriverInfo info_;
  std::vector<JointResponse> responses_;
  std::atomic<bool> prepared_ = false;

  mutable std::mutex mutex_;  // everything below, held for copies only
  std::condition_variable arrived_;
  DriverHealth health_;
  RobotState state_;
  bool has_state_ = false, lost_ = false;
  int64_t received_ns_ = 0;
  int reports_since_outage_ = 0;
  uint32_t last_number_ = 0;
  std::string implausible_;
  ClockMap clock_map_;
  RateEstimate rate_;
  std::vector<Unwrapper> unwrappers_;
  MotionWatch motion_watch_;
  bool streaming_ = false, mode_lost_ = false, moving_ = false, watch_motion_ = false;
  bool under_way_ = false;  // a move's thread runs
  Status move_end_;
  bool position_mode_owed_ = false;
  JointArray command_{};
  int64_t commanded_ns_ = 0;
  int64_t next_try_ns_ = 0;  // of the sender to get position mode

  std::atomic<bool> ended_ = false, stop_move_ = false;
  std::thread sender_, mover_;
  std::mutex services_;            // one call at a time
  std::unique_ptr<ArmLink> link_;  // gone first: its listener uses what is above
};

}  // namespace rg::robot_agent::kinova
