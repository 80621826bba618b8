// A robot of two joints in memory: time passes only in SleepUntil, states and faults are scripted.
#pragma once

#include <chrono>
#include <functional>
#include <string>
#include <thread>
#include <vector>

#include "robot_agent/controller.h"
#include "robot_agent/drivers/driver.h"
#include "robot_agent/safety/arm.h"
#include "robot_agent/safety/limits.h"

namespace rg::robot_agent {

class FakeDriver final : public Driver {
 public:
  FakeDriver() {
    info_.robot = "fake";
    info_.joints = {"a", "b"};
    info_.lock_step = true;
    state.stamp_ns = now_ - 5'000'000;
    state.sequence = 1;
  }
  Status Connect(double) override { return Status::Ok(); }
  const DriverInfo& info() const override { return info_; }
  DriverHealth health() const override { return {}; }
  int64_t NowNanos() const override { return now_; }
  Status SleepUntil(int64_t deadline) override {
    if (lost) return UnavailableError("lost");
    now_ = std::max(now_, deadline + oversleep_ns);
    oversleep_ns = 0;
    ++tick;
    state.stamp_ns = now_ - 5'000'000;
    ++state.sequence;
    state.q[1] += state.sequence % 2 ? 1e-7 : -1e-7;  // the noise of a real sensor
    if (script) script(*this);
    return Status::Ok();
  }
  Status ReadState(RobotState* out) override {
    if (lost) return UnavailableError("lost");
    *out = state;
    return Status::Ok();
  }
  Status EnterTorqueMode(const double* first) override {
    entered.assign(first, first + 2);
    if (refuse) return FailedPreconditionError("refused");
    for (int k = 0; slow_entry && k < 30'000; ++k) {
      if (stop_asked()) return CancelledError("stopped");
      if (script) script(*this);
      if (const Status judged = JudgeEntry(); !judged.ok()) return judged;
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    state.mode = Mode::kTorque;
    return Status::Ok();
  }
  Status SendTorque(const double* tau) override {
    sent[sent_count++ % sent.size()] = {tau[0], tau[1]};
    return Status::Ok();
  }
  Status Hold() override {
    ++holds;
    now_ += hold_takes_ns;
    state.mode = Mode::kPosition;
    return lost ? UnavailableError("lost") : Status::Ok();
  }
  Status StartMove(const double*) override {
    ++moves;
    return Status::Ok();
  }
  Status MoveEnd() override { return move_end; }
  bool StopWanted() const override { return stop_wanted; }

  DriverInfo info_;
  int64_t now_ = 1'000'000'000;
  int tick = -1;  // of the control loop: the number of SleepUntil calls so far, from 0
  int64_t oversleep_ns = 0, hold_takes_ns = 0;
  bool lost = false, refuse = false, slow_entry = false, stop_wanted = false;
  int holds = 0, moves = 0;
  Status move_end;
  RobotState state;
  std::vector<double> entered;
  std::vector<std::array<double, 2>> sent = std::vector<std::array<double, 2>>(4096);
  size_t sent_count = 0;
  std::function<void(FakeDriver&)> script;  // at the end of every SleepUntil
};

inline SafetyLimits FakeLimits() {
  SafetyLimits limits;
  limits.lower = {-1, -1};
  limits.upper = {1, 1};
  limits.velocity = {2, 2};
  limits.torque = {10, 10};
  limits.torque_rate = {1000, 1000};
  return limits;
}

// Gravity (1, 2) N·m everywhere; the end effector is at (q0, q1, 0).
class FakeArm final : public ArmModel {
 public:
  void GravityTorque(const double*, double* tau) override { tau[0] = 1.0, tau[1] = 2.0; }
  void Tip(const double* q, double* position) override {
    position[0] = q[0], position[1] = q[1], position[2] = 0;
  }
};

}  // namespace rg::robot_agent
