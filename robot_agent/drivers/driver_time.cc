#include "robot_agent/drivers/driver_time.h"

#include <time.h>

#include <algorithm>

#include "common/base/clock.h"

namespace rg::robot_agent {
namespace {

class Machine final : public DriverTime {
 public:
  int64_t NowNanos() const override { return RealClock().SteadyNanos(); }

  void SleepUntil(int64_t deadline_ns) override {
    const timespec until{deadline_ns / 1'000'000'000, deadline_ns % 1'000'000'000};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) {
    }
  }

  bool Wait(std::unique_lock<std::mutex>& lock, std::condition_variable& changed, int64_t deadline_ns,
            const std::function<bool()>& done) override {
    const int64_t left = std::max<int64_t>(deadline_ns - NowNanos(), 0);
    return changed.wait_for(lock, std::chrono::nanoseconds(left), done);
  }

  std::unique_lock<std::mutex> Lock(std::mutex& mutex) override { return std::unique_lock(mutex); }
  std::thread Start(std::function<void()> body) override { return std::thread(std::move(body)); }
  void Join(std::thread& thread) override { thread.join(); }
};

}  // namespace

std::shared_ptr<DriverTime> MachineTime() {
  static const auto machine = std::make_shared<Machine>();
  return machine;
}

}  // namespace rg::robot_agent
