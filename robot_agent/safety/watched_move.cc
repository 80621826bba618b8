#include "robot_agent/safety/watched_move.h"

#include <algorithm>
#include <cmath>
#include <string>

namespace rg::robot_agent {
namespace {

constexpr int64_t kWatchEvery = 20'000'000;  // ns

class WatchedMove {
 public:
  WatchedMove(Driver& driver, ArmModel& arm, const SafetyLimits& limits, const double* q,
              const MoveOptions& options, const CancelToken& stop)
      : driver_(driver),
        arm_(arm),
        target_(q),
        options_(options),
        stop_(stop),
        n_(static_cast<int>(driver.info().joints.size())),
        monitor_(limits, n_) {}

  MoveOutcome Run() {
    MoveOutcome outcome;
    outcome.status = Go();
    outcome.trip = monitor_.trip();
    if (!outcome.status.ok()) outcome.stop = StopArm(driver_, options_.stop);
    return outcome;
  }

 private:
  Status Go() {
    RG_RETURN_IF_ERROR(Look(false));  // where it stands must be good already
    RG_RETURN_IF_ERROR(driver_.StartMove(target_));
    const int64_t give_up = driver_.NowNanos() + std::llround(1e9 * options_.timeout_s);
    while (true) {
      RG_RETURN_IF_ERROR(Look(true));
      if (!seen_.state.moving) RG_RETURN_IF_ERROR(driver_.MoveEnd());
      if (!seen_.state.moving && Distance() <= options_.tolerance) break;
      RG_RETURN_IF_ERROR(CheckNotStalled());
      if (driver_.NowNanos() >= give_up)
        return DeadlineExceededError("the pose was not reached within " + std::to_string(options_.timeout_s) +
                                     " s, still " + std::to_string(Distance()) + " rad away");
      reached_ = driver_.SleepUntil(driver_.NowNanos() + kWatchEvery).ok();
    }
    const int64_t settled = driver_.NowNanos() + std::llround(1e9 * options_.settle_s);
    while (driver_.NowNanos() < settled) {
      reached_ = driver_.SleepUntil(std::min(settled, driver_.NowNanos() + kWatchEvery)).ok();
      RG_RETURN_IF_ERROR(Look(false));
    }
    return Status::Ok();
  }

  // An arm that gave up by itself or was stopped by somebody else (its base, a guard, a person) does not wait for
  // the time-out.
  Status CheckNotStalled() {
    const int64_t now = driver_.NowNanos();
    if (seen_.state.moving || last_moved_ns_ == 0) last_moved_ns_ = now;
    if (1e-9 * static_cast<double>(now - last_moved_ns_) < options_.stall_s) return Status::Ok();
    return FailedPreconditionError("the arm stopped by itself, " + std::to_string(Distance()) +
                                   " rad short of the pose");
  }

  // Not ok: the monitor tripped.
  Status Look(bool under_way) {
    const Status read = driver_.ReadState(&seen_.state);
    seen_.now_ns = driver_.NowNanos();
    seen_.connected = reached_ && read.ok();
    seen_.has_state |= read.ok();
    seen_.operator_stop = stop_.cancelled();
    if (seen_.has_state) {
      arm_.Tip(seen_.state.q.data(), tip_);
      seen_.clearance = arm_.Clearance(seen_.state.q.data(), &seen_.nearest_pair);
    }
    seen_.tip = seen_.has_state ? tip_ : nullptr;
    if (read.ok() && options_.on_state) options_.on_state(seen_.state);
    if (monitor_.OnMove(seen_, under_way) == Action::kCommand) return Status::Ok();
    const Trip& trip = monitor_.trip();
    if (trip.reason == EndReason::kOperatorStop) return CancelledError("stopped on the way");
    if (trip.reason == EndReason::kDriverLost) return UnavailableError(read.ok() ? "lost" : read.message());
    const std::string detail = DescribeTrip(trip, driver_.info().joints);
    return FailedPreconditionError(std::string(EndReasonName(trip.reason)) +
                                   (detail.empty() ? "" : ": " + detail));
  }

  double Distance() const {
    double worst = 0.0;
    for (int i = 0; i < n_; ++i) worst = std::max(worst, std::abs(seen_.state.q[i] - target_[i]));
    return worst;
  }

  Driver& driver_;
  ArmModel& arm_;
  const double* target_;
  const MoveOptions& options_;
  const CancelToken& stop_;
  const int n_;
  SafetyMonitor monitor_;
  Observation seen_;
  double tip_[3] = {};
  bool reached_ = true;
  int64_t last_moved_ns_ = 0;
};

}  // namespace

MoveOutcome MoveUnderWatch(Driver& driver, ArmModel& arm, const SafetyLimits& limits, const double* q,
                           const MoveOptions& options, const CancelToken& operator_stop) {
  return WatchedMove(driver, arm, limits, q, options, operator_stop).Run();
}

}  // namespace rg::robot_agent
