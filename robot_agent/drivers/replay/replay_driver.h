// A recording played back as if it were an arm.
//
// In position mode the arm stands at the recording's first row; EnterTorqueMode starts it, and the state is
// then the newest row that is not later than the time since. Torques change nothing. After the last row no
// new state comes, so that the monitor sees a stale one, and as soon as somebody asks for position mode the
// arm stands where it was. MoveToPose goes to the first row only: another start is refused
// (kFailedPrecondition).
//
// In lock-step time passes in SleepUntil and MoveToPose only. One thread.
#pragma once

#include <string>
#include <vector>

#include "common/recordings/recording.h"
#include "robot_agent/drivers/driver.h"

namespace rg::robot_agent {

struct ReplayOptions {
  std::string robot;      // the agent's name of it
  std::string folder;     // of the set
  std::string recording;  // its name in the set; empty: the first
  bool lock_step = false;
};

class ReplayDriver final : public Driver {
 public:
  explicit ReplayDriver(ReplayOptions options) : options_(std::move(options)) {}

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
  Status MoveToPose(const double* q, double tolerance, double timeout_s) override;

 private:
  int n() const { return static_cast<int>(info_.joints.size()); }
  // The row at the present time.
  int RowNow() const;

  const ReplayOptions options_;
  DriverInfo info_;
  DriverHealth health_;
  recordings::Recording recording_;
  int64_t lock_step_ns_ = 0, start_ns_ = 0;
  uint64_t sequence_ = 0;
  int row_ = 0;
  Mode mode_ = Mode::kPosition;
};

}  // namespace rg::robot_agent
