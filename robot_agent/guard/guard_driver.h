// The arm as the agent sees it when a guard stands between: a driver whose every call is a request to the
// process realitygrad-guard. The guard outlives the agent's executor; it ends when the socket closes and the
// arm is at rest.
#pragma once

#include <sys/types.h>

#include <memory>
#include <string>
#include <vector>

#include "robot_agent/drivers/driver.h"
#include "robot_agent/drivers/packet_socket.h"
#include "robot_agent/guard/guard_protocol.h"

namespace rg::robot_agent {

class GuardDriver final : public Driver {
 public:
  // arguments: the program and its flags; "--socket-fd N" is added. `period_s`: of the control cycle.
  static Result<std::unique_ptr<GuardDriver>> Start(std::vector<std::string> arguments, double period_s);
  // For a guard that is served elsewhere (tests).
  GuardDriver(PacketSocket socket, double period_s) : socket_(std::move(socket)), period_s_(period_s) {}
  ~GuardDriver() override;

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
  Status MoveEnd() override;

  // What the guard stopped the arm for; kNone: nothing.
  const Trip& trip() const { return reply_.trip; }
  pid_t pid() const { return pid_; }

 private:
  Status Ask(GuardRequest request, const double* values, double timeout_s);
  Status Tell(GuardRequest request, const double* values);
  // kDeadlineExceeded: no reply within that; the guard may be asked on.
  Status Await(double timeout_s);
  Status Lost(const char* what);

  PacketSocket socket_;
  const double period_s_;
  pid_t pid_ = -1;
  DriverInfo info_;
  DriverHealth health_;
  GuardMessage request_, reply_;
  uint64_t sequence_ = 0;
  int64_t time_ns_ = 0;  // lock-step
  bool lost_ = false, answered_ = false;
};

}  // namespace rg::robot_agent
