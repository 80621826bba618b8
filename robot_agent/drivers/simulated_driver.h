// Drives the program realitygrad-simulated-robot over a socket: started by this driver as a child on a
// socket pair, or by hand with --socket PATH. Real time or lock-step (see robot_protocol.h).
//
// In lock-step the robot's time passes only inside SleepUntil, EnterTorqueMode and StartMove, so a
// rollout takes as long as its computation and is the same for the same seed.
#pragma once

#include <sys/types.h>

#include <memory>
#include <string>

#include "robot_agent/drivers/driver.h"
#include "robot_agent/drivers/packet_socket.h"
#include "robot_agent/drivers/robot_protocol.h"

namespace rg::robot_agent {

struct SimulatedDriverOptions {
  std::string program;      // empty: realitygrad-simulated-robot beside the running program
  std::string truth_path;   // handed to the program
  std::string socket_path;  // not empty: connect to a robot that runs already, start none
  uint64_t seed = 1;        // sensor noise
  bool lock_step = false;
  bool allow_faults = false;
  double reply_timeout_s = 2.0;  // machine time a request may take before the robot counts as lost
};

class SimulatedDriver final : public Driver {
 public:
  explicit SimulatedDriver(SimulatedDriverOptions options);
  ~SimulatedDriver() override;  // ends and reaps a child it started

  Status Connect(double timeout_s) override;
  const DriverInfo& info() const override { return info_; }
  DriverHealth health() const override { return health_; }
  int64_t NowNanos() const override;
  Status SleepUntil(int64_t deadline_ns) override;
  Status ReadState(RobotState* state) override;
  Status EnterTorqueMode(const double* first) override;
  Status SendTorque(const double* tau) override;
  Status Hold() override;
  Status StartMove(const double* q) override;

  // For tests; the robot must run with --allow-faults.
  Status InjectFault(Fault fault, double strength = 0.0);
  pid_t pid() const { return pid_; }  // of the child, -1: none

 private:
  Status StartChild();
  Status Greet(double timeout_s);
  int joints() const { return static_cast<int>(info_.joints.size()); }
  RobotMessage Request(MessageType type, const double* values);
  Status Send(const RobotMessage& message);
  // Sends and takes messages until `reply` came; its content is in last_.
  Status Ask(const RobotMessage& message, MessageType reply);
  void TakeMessage(size_t bytes);
  void TakeState(const RobotMessage& message);
  void DrainStates();
  Status Lost(const char* what);
  // The first state measured after the acknowledged request.
  Status AwaitStateFrom(uint64_t sequence, double timeout_s, RobotState* state);

  const SimulatedDriverOptions options_;
  DriverInfo info_;
  DriverHealth health_;
  PacketSocket socket_;
  pid_t pid_ = -1;
  bool lost_ = false;
  int64_t robot_time_ns_ = 0;  // lock-step
  uint64_t requests_ = 0;
  RobotMessage last_;
  RobotState state_;
  bool has_state_ = false;
};

}  // namespace rg::robot_agent
