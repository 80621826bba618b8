// The simulated robot without its process: drives, base firmware, arm and sensors as a pure function
// of the commands and their times. Deterministic by seed; no clock, no socket. One thread.
//
// Time starts at zero and passes in AdvanceTo. Firmware: position mode follows a reference with a stiff
// controller and its own (true) gravity model; torque mode applies the last command, limited to
// what the drives can give, plus the base's gravity compensation if it has one; commands that stop
// coming end as RobotTruth::silence_action says.
#pragma once

#include <cstdint>
#include <deque>
#include <string>

#include "common/base/rng.h"
#include "common/dynamics/dynamics.h"
#include "common/sim/simulator.h"
#include "robot_agent/drivers/driver.h"
#include "robot_agent/drivers/robot_protocol.h"
#include "robot_agent/simulated_robot/truth.h"

namespace rg::robot_agent {

class RobotWorld {
 public:
  RobotWorld(const RobotTruth& truth, uint64_t seed);

  DriverInfo Info() const;
  int64_t time_ns() const { return time_ns_; }
  Mode mode() const { return mode_; }
  // The sequence number that the next measurement will have.
  uint64_t next_sequence() const { return sequence_ + 1; }

  // Requests arrive at the present time. Values: n.
  void EnterTorque(const double* first);
  void Torque(const double* tau);
  void Hold();
  void MoveTo(const double* q);
  void Inject(Fault fault, double strength);

  // Runs whole cycles up to `time_ns` (at most one cycle short of it).
  void AdvanceTo(int64_t time_ns);
  // The newest measurement delivered by now, once; false: nothing new.
  bool TakeState(RobotState* state);
  // The newest measurement delivered by now, again and again; false before the first.
  bool NewestState(RobotState* state);

  // For tests and reports: what really is, and what went wrong with the physics (empty: nothing).
  const sim::State& true_state() const { return x_; }
  // The joint torque that a perfect sensor in the drive shows, filtered (n), and what the base's compensation
  // believes gravity takes at q (n).
  const Eigen::VectorXd& effort() const { return effort_; }
  Eigen::VectorXd BelievedGravity(const Eigen::VectorXd& q);
  const std::string& failure() const { return failure_; }

 private:
  struct Delayed {
    int64_t at_ns = 0;
    JointArray tau{};
  };

  void Cycle();
  void TakeCommands();
  void CheckSilence();
  void UpdateReference();
  Eigen::VectorXd PositionControl();
  Eigen::VectorXd TorqueControl();
  void Measure();
  double Quantised(double value) const;
  void SetPositionTarget(const Eigen::VectorXd& target, double duration_s);

  const RobotTruth& truth_;
  const int n_;
  const int64_t cycle_ns_, period_ns_, latency_ns_;
  sim::Simulator simulator_;
  sim::State x_;
  dynamics::Mechanism true_arm_, base_arm_;  // base_arm_: what the compensation believes
  dynamics::Workspace workspace_;
  Rng noise_;

  int64_t time_ns_ = 0;
  Mode mode_ = Mode::kPosition;
  std::deque<Delayed> commands_;
  Eigen::VectorXd command_, gravity_, effort_;
  int64_t last_heard_ns_ = 0;
  Eigen::VectorXd from_, target_, reference_, reference_rate_;
  int64_t move_start_ns_ = 0;
  double move_duration_s_ = 0.0;

  uint64_t sequence_ = 0;
  int64_t next_measurement_ns_ = 0;
  std::deque<RobotState> in_flight_;
  RobotState newest_;
  bool has_newest_ = false;
  bool fault_nan_ = false, fault_refuse_ = false;
  double fault_jump_ = 0.0;
  std::string failure_;
};

}  // namespace rg::robot_agent
