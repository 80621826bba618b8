// An arm that is only looked at: states come from the real driver, nothing that moves reaches it. For
// `realitygrad agent --dry-run`: the whole rollout is computed, shown and judged, from where the arm stands.
#pragma once

#include <memory>

#include "robot_agent/drivers/driver.h"

namespace rg::robot_agent {

class DryRunDriver final : public Driver {
 public:
  explicit DryRunDriver(std::unique_ptr<Driver> arm) : arm_(std::move(arm)) {}

  Status Connect(double timeout_s) override { return arm_->Connect(timeout_s); }
  const DriverInfo& info() const override { return arm_->info(); }
  DriverHealth health() const override { return arm_->health(); }
  int64_t NowNanos() const override { return arm_->NowNanos(); }
  Status SleepUntil(int64_t deadline_ns) override { return arm_->SleepUntil(deadline_ns); }
  // The mode is the one that was asked for.
  Status ReadState(RobotState* state) override {
    const Status read = arm_->ReadState(state);
    state->mode = mode_;
    return read;
  }
  Status EnterTorqueMode(const double*) override { return mode_ = Mode::kTorque, Status::Ok(); }
  Status SendTorque(const double*) override { return Status::Ok(); }
  Status Hold() override { return mode_ = Mode::kPosition, Status::Ok(); }
  Status StartMove(const double*) override { return Status::Ok(); }

 private:
  const std::unique_ptr<Driver> arm_;
  Mode mode_ = Mode::kPosition;
};

}  // namespace rg::robot_agent
