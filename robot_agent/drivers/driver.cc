#include "robot_agent/drivers/driver.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <thread>

namespace rg::robot_agent {

Status Driver::MoveToPose(const double* q, double tolerance, double timeout_s) {
  RG_RETURN_IF_ERROR(StartMove(q));
  const int64_t give_up = NowNanos() + std::llround(1e9 * timeout_s);
  double worst = 0.0;
  while (NowNanos() < give_up) {
    RobotState state;
    RG_RETURN_IF_ERROR(ReadState(&state));
    worst = 0.0;
    for (size_t i = 0; i < info().joints.size(); ++i) worst = std::max(worst, std::abs(state.q[i] - q[i]));
    if (!state.moving && worst <= tolerance) return Status::Ok();
    RG_RETURN_IF_ERROR(SleepUntil(NowNanos() + 20'000'000));
  }
  RG_RETURN_IF_ERROR(Hold());
  return DeadlineExceededError("the pose was not reached within " + std::to_string(timeout_s) + " s, still " +
                               std::to_string(worst) + " rad away");
}

void Pause(Driver& driver, double seconds) {
  const int64_t length = std::llround(1e9 * seconds), until = driver.NowNanos() + length;
  if (driver.SleepUntil(until).ok() || driver.NowNanos() >= until) return;
  std::this_thread::sleep_for(std::chrono::nanoseconds(length));
}

}  // namespace rg::robot_agent
