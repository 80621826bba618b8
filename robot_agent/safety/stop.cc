#include "robot_agent/safety/stop.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>

#include "common/base/printf.h"

namespace rg::robot_agent {
namespace {

constexpr double kLook = 0.02;  // s between looks at the state
constexpr double kNoSpeed = -1.0;

int64_t Nanos(double seconds) { return std::llround(1e9 * seconds); }

// The speed of the fastest joint, differenced over at least the baseline.
class SpeedWatch {
 public:
  SpeedWatch(int n, double baseline_s) : n_(n), baseline_ns_(Nanos(baseline_s)) {}

  // Negative: not known yet.
  double Take(const RobotState& state) {
    if (count_ > 0 && state.stamp_ns <= Past(0).stamp_ns) return speed_;
    newest_ = (newest_ + 1) % kHistory;
    history_[newest_] = {state.stamp_ns, state.q};
    count_ = std::min(count_ + 1, kHistory);
    for (int back = 1; back < count_; ++back) {
      const int64_t dt = state.stamp_ns - Past(back).stamp_ns;
      if (dt < baseline_ns_) continue;
      speed_ = 0.0;
      for (int i = 0; i < n_; ++i) {
        const double v = std::abs(state.q[i] - Past(back).q[i]) / (1e-9 * static_cast<double>(dt));
        speed_ = std::isfinite(v) ? std::max(speed_, v) : INFINITY;
      }
      break;
    }
    return speed_;
  }

 private:
  static constexpr int kHistory = 64;
  struct Position {
    int64_t stamp_ns = 0;
    JointArray q{};
  };
  const Position& Past(int back) const { return history_[(newest_ + kHistory - back) % kHistory]; }

  const int n_;
  const int64_t baseline_ns_;
  std::array<Position, kHistory> history_{};
  int count_ = 0, newest_ = 0;
  double speed_ = kNoSpeed;
};

// By the driver's time, by the machine's clock where that stands still.
class Patience {
 public:
  Patience(Driver& driver, double seconds)
      : driver_(driver),
        limit_(Nanos(seconds)),
        driver_begin_(driver.NowNanos()),
        machine_begin_(std::chrono::steady_clock::now()) {}

  bool Over() const {
    const int64_t passed = driver_.NowNanos() - driver_begin_;
    if (passed > 0) return passed >= limit_;
    return std::chrono::steady_clock::now() - machine_begin_ >= std::chrono::nanoseconds(limit_);
  }

 private:
  Driver& driver_;
  const int64_t limit_, driver_begin_;
  const std::chrono::steady_clock::time_point machine_begin_;
};

// Asks again and again for one attempt's time: an arm that is away for a moment hears it when it is back.
bool HoldIsTaken(Driver& driver, const StopOptions& options, StopReport* report) {
  const Patience patience(driver, options.attempt_s);
  while (true) {
    const Status held = driver.Hold();
    if (held.ok()) return true;
    report->why = held.message();
    if (patience.Over()) return false;
    Pause(driver, kLook);
  }
}

// Looks until the arm was at rest in position mode for long enough; false: not within attempt_s.
bool SeenAtRest(Driver& driver, const StopOptions& options, StopReport* report) {
  SpeedWatch watch(static_cast<int>(driver.info().joints.size()), options.baseline_s);
  const int looks = static_cast<int>(std::ceil(options.attempt_s / kLook));
  int64_t rest_since = 0;
  bool resting = false;
  report->why = "no state arrived";
  for (int look = 0; look <= looks; ++look) {
    RobotState state;
    const Status read = driver.ReadState(&state);
    if (!read.ok()) {
      report->why = read.message();
      resting = false;
    } else {
      report->worst_speed = watch.Take(state);
      const bool slow = report->worst_speed >= 0.0 && report->worst_speed < options.at_rest;
      const bool good = slow && state.mode == Mode::kPosition;
      if (good && !resting) rest_since = state.stamp_ns;
      resting = good;
      if (resting && state.stamp_ns - rest_since >= Nanos(options.at_rest_s)) return true;
      const std::string text =
          Printf("the arm moves at %.3g rad/s, limit %.3g", report->worst_speed, options.at_rest);
      if (state.mode != Mode::kPosition)
        report->why = "the arm stays in torque mode";
      else if (report->worst_speed < 0.0)
        report->why = "the stamps of its states do not advance";
      else if (!slow)
        report->why = text;
      else
        report->why = "it was not at rest for long enough";
    }
    Pause(driver, kLook);
  }
  return false;
}

}  // namespace

StopReport StopArm(Driver& driver, const StopOptions& options) {
  StopReport report;
  report.worst_speed = kNoSpeed;
  const int64_t begin = driver.NowNanos();
  while (!report.confirmed && report.attempts < options.attempts) {
    ++report.attempts;
    report.confirmed = HoldIsTaken(driver, options, &report) && SeenAtRest(driver, options, &report);
  }
  report.took_s = 1e-9 * static_cast<double>(driver.NowNanos() - begin);
  if (report.confirmed) report.why.clear();
  return report;
}

}  // namespace rg::robot_agent
