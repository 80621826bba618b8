// A driver's time that passes when all its threads sleep: a session of minutes takes as long as its computing.
//
// One thread of those that live in it runs at a time. Where it sleeps, the one that wakes first goes on (of equals
// the one that lay down first), and the time is then its. So what happens does not depend on the machine's
// scheduler: the same calls, the same session. A thread that waits for something else than this time
// (a file, a thread outside) makes the time wait too.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <condition_variable>
#include <map>
#include <memory>
#include <mutex>
#include <vector>

#include "robot_agent/drivers/driver_time.h"

namespace rg::robot_agent {

class VirtualTime final : public DriverTime {
 public:
  // The calling thread lives in it.
  VirtualTime() { Me() = running_ = new Sleeper; }
  ~VirtualTime() override { delete std::exchange(Me(), nullptr); }

  int64_t NowNanos() const override {
    const std::lock_guard lock(mutex_);
    return now_;
  }

  void SleepUntil(int64_t deadline_ns) override {
    std::unique_lock lock(mutex_);
    Sleeper* const me = Me();
    LieDown(me, deadline_ns);
    WakeNext();
    me->go.wait(lock, [&] { return running_ == me; });
  }

  bool Wait(std::unique_lock<std::mutex>& lock, std::condition_variable&, int64_t deadline_ns,
            const std::function<bool()>& done) override {
    while (!done() && NowNanos() < deadline_ns) {
      lock.unlock();
      SleepUntil(std::min(deadline_ns, WhenSomebodyActs()));
      lock.lock();
    }
    return done();
  }

  std::unique_lock<std::mutex> Lock(std::mutex& mutex) override {
    std::unique_lock lock(mutex, std::try_to_lock);
    while (!lock.owns_lock()) {
      SleepUntil(WhenSomebodyActs());
      (void)lock.try_lock();
    }
    return lock;
  }

  std::thread Start(std::function<void()> body) override {
    auto* const child = new Sleeper;
    const auto ended = std::make_shared<bool>(false);
    std::unique_lock lock(mutex_);
    LieDown(child, now_);
    std::thread thread([this, child, ended, body = std::move(body)] {
      Me() = child;
      {
        std::unique_lock waiting(mutex_);
        child->go.wait(waiting, [&] { return running_ == child; });
      }
      body();
      const std::lock_guard leaving(mutex_);
      *ended = true;
      WakeNext();
      delete child;
    });
    ended_[thread.get_id()] = ended;
    return thread;
  }

  void Join(std::thread& thread) override {
    std::shared_ptr<bool> ended;
    {
      const std::lock_guard lock(mutex_);
      ended = ended_.at(thread.get_id());
      ended_.erase(thread.get_id());
    }
    const auto has_ended = [&] {
      const std::lock_guard lock(mutex_);
      return *ended;
    };
    while (!has_ended()) SleepUntil(WhenSomebodyActs());
    thread.join();
  }

 private:
  // Nothing changes before somebody else wakes. At the least a look's time, so that two that wait for the same do not
  // wait for each other.
  int64_t WhenSomebodyActs() const {
    const std::lock_guard lock(mutex_);
    int64_t next = INT64_MAX;
    for (const Sleeper* sleeper : sleepers_) next = std::min(next, sleeper->wake_ns);
    return std::max(next == INT64_MAX ? now_ : next, now_ + kLook);
  }

  static constexpr int64_t kLook = 1'000'000;
  struct Sleeper {
    int64_t wake_ns = 0;
    uint64_t order = 0;
    std::condition_variable go;
  };
  static Sleeper*& Me() {
    static thread_local Sleeper* me = nullptr;
    return me;
  }

  void LieDown(Sleeper* sleeper, int64_t wake_ns) {
    sleeper->wake_ns = std::max(wake_ns, now_);
    sleeper->order = ++order_;
    sleepers_.push_back(sleeper);
  }
  void WakeNext() {
    const auto next = std::min_element(sleepers_.begin(), sleepers_.end(), [](auto* a, auto* b) {
      return std::pair(a->wake_ns, a->order) < std::pair(b->wake_ns, b->order);
    });
    running_ = *next;  // whoever leaves, somebody joins it
    sleepers_.erase(next);
    now_ = running_->wake_ns;
    running_->go.notify_one();
  }

  mutable std::mutex mutex_;
  int64_t now_ = 1'000'000'000'000;
  uint64_t order_ = 0;
  std::vector<Sleeper*> sleepers_;
  Sleeper* running_ = nullptr;
  std::map<std::thread::id, std::shared_ptr<bool>> ended_;
};

}  // namespace rg::robot_agent
