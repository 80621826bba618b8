// The time that a driver lives in: the machine's steady clock, or one that a test lets pass. What waits, and what
// runs in a thread of its own, goes through it, so that a whole session with an arm takes as long as its
// computing does (tests/support/virtual_time.h).
//
// A driver holds no mutex while it sleeps, but for one taken by Lock.
#pragma once

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <thread>

namespace rg::robot_agent {

class DriverTime {
 public:
  virtual ~DriverTime() = default;
  virtual int64_t NowNanos() const = 0;
  virtual void SleepUntil(int64_t deadline_ns) = 0;
  // Until done() or the deadline: the last answer of done(), which is asked with `lock` held, at least whenever
  // `changed` is notified.
  virtual bool Wait(std::unique_lock<std::mutex>& lock, std::condition_variable& changed, int64_t deadline_ns,
                    const std::function<bool()>& done) = 0;
  // For a mutex whose owners sleep.
  virtual std::unique_lock<std::mutex> Lock(std::mutex& mutex) = 0;
  virtual std::thread Start(std::function<void()> body) = 0;
  virtual void Join(std::thread& thread) = 0;
};

std::shared_ptr<DriverTime> MachineTime();

}  // namespace rg::robot_agent
