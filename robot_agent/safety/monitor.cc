#include "robot_agent/safety/monitor.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "common/base/printf.h"

namespace rg::robot_agent {
namespace {

constexpr std::string_view kNames[] = {
    "none",          "completed",        "position_limit",   "velocity_limit",
    "torque_limit",  "task_space_limit", "controller_nan",   "robot_nan",
    "stale_state",   "impossible_state", "missed_deadlines", "driver_lost",
    "operator_stop", "recorder_failed",  "mode_lost",        "interrupted",
    "not_started",   "frozen_state",     "controller_hung",  "self_collision"};

// From `last` towards gravity, not beyond it: letting go is never held up.
bool Releases(double last, double tau, double gravity) {
  const double before = last - gravity, after = tau - gravity;
  return before * after >= 0.0 && std::abs(after) <= std::abs(before);
}

constexpr int64_t kFutureTolerance = 5'000'000;  // a stamp this far ahead of now is still a rounding

}  // namespace

std::string_view EndReasonName(EndReason reason) {
  const auto index = static_cast<size_t>(reason);
  return index < std::size(kNames) ? kNames[index] : "unknown";
}

EndReason EndReasonFromName(std::string_view name) {
  const auto* found = std::find(std::begin(kNames), std::end(kNames), name);
  return found == std::end(kNames) ? EndReason::kNone : static_cast<EndReason>(found - std::begin(kNames));
}

SafetyMonitor::SafetyMonitor(const SafetyLimits& limits, int n, double period_s)
    : limits_(limits), n_(n), period_s_(period_s) {}

Action SafetyMonitor::OnMove(const Observation& seen, bool under_way) {
  if (phase_ == Phase::kHold) return Action::kHold;
  moving_ = true;
  if (under_way && !told_to_move_) told_since_ns_ = seen.state.stamp_ns;
  told_to_move_ = under_way;
  if (!has_start_ && seen.has_state) WidenToStart(seen);
  CheckEverything(seen, Mode::kPosition);
  moving_ = false;
  if (trip_.reason == EndReason::kNone) return Action::kCommand;
  phase_ = Phase::kHold;
  return Action::kHold;
}

Action SafetyMonitor::CheckFirst(const Observation& seen, const double* tau) {
  told_to_move_ = false;
  CheckEverything(seen, Mode::kPosition);
  for (int i = 0; i < n_; ++i) {
    if (!std::isfinite(tau[i])) Raise(seen, EndReason::kControllerNan, i, tau[i]);
    if (std::abs(tau[i]) > limits_.torque[i])
      Raise(seen, EndReason::kTorqueLimit, i, tau[i], limits_.torque[i]);
  }
  if (trip_.reason != EndReason::kNone) {
    phase_ = Phase::kHold;
    return Action::kHold;
  }
  std::copy_n(tau, n_, last_.begin());
  last_ns_ = seen.now_ns;
  has_last_ = true;
  return Action::kCommand;
}

Action SafetyMonitor::OnTick(const Observation& seen) {
  if (ticks_++ == 0) first_tick_ns_ = seen.now_ns;
  if (phase_ == Phase::kRunning) {
    CheckEverything(seen, Mode::kTorque);
    if (trip_.reason == EndReason::kNone) return Action::kCommand;
    phase_ = Phase::kZeroTorque;
  }
  return AfterTrip(seen);
}

Action SafetyMonitor::LimitCommand(double* tau, const double* gravity, int64_t now_ns) {
  Observation now;
  now.now_ns = now_ns;
  for (int i = 0; i < n_; ++i)
    if (!std::isfinite(tau[i])) Raise(now, EndReason::kControllerNan, i, tau[i]);
  for (int i = 0; i < n_; ++i) {
    const double trip_level = limits_.torque_trip_ratio * limits_.torque[i];
    if (std::abs(tau[i]) > trip_level) Raise(now, EndReason::kTorqueLimit, i, tau[i], trip_level);
  }
  if (trip_.reason != EndReason::kNone) {
    phase_ = Phase::kZeroTorque;
    return limits_.zero_torque_s > 0 ? Action::kZeroAdded : Action::kHold;
  }
  bool saturated = false;
  const double dt = 1e-9 * static_cast<double>(now_ns - last_ns_);
  for (int i = 0; i < n_; ++i) {
    const double most = limits_.torque[i];
    const double step = limits_.torque_rate[i] * std::max(dt, period_s_);
    double limited = std::clamp(tau[i], -most, most);
    if (has_last_ && !(gravity != nullptr && Releases(last_[i], limited, gravity[i])))
      limited = std::clamp(limited, last_[i] - step, last_[i] + step);
    saturated |= limited != tau[i];
    tau[i] = limited;
  }
  saturated_ += saturated;
  std::copy_n(tau, n_, last_.begin());
  last_ns_ = now_ns;
  has_last_ = true;
  const bool pushes = gravity != nullptr && PushShare(tau, gravity) > kClearPush;
  if (pushes && !told_to_move_) told_since_ns_ = previous_.stamp_ns;
  told_to_move_ = pushes;
  return Action::kCommand;
}

double SafetyMonitor::PushShare(const double* tau, const double* gravity) const {
  double share = 0.0;
  for (int i = 0; i < n_; ++i) share = std::max(share, std::abs(tau[i] - gravity[i]) / limits_.torque[i]);
  return share;
}

// In the order of trust: whoever is not there cannot be judged by what it said.
void SafetyMonitor::CheckEverything(const Observation& seen, Mode expected) {
  CheckLiveness(seen, expected);
  if (seen.has_state) {
    CheckStamp(seen);
    CheckFinite(seen);
    if (trip_.reason == EndReason::kNone) {
      CheckJump(seen);
      if (!has_previous_ || seen.state.stamp_ns > previous_.stamp_ns) Remember(seen.state);
      CheckBoxes(seen);
      CheckFrozen(seen);
      previous_ = seen.state;
      has_previous_ = true;
    }
  }
  if (expected == Mode::kTorque) CheckDeadlines(seen);
  if (seen.time_up) Raise(seen, EndReason::kCompleted);
}

void SafetyMonitor::CheckLiveness(const Observation& seen, Mode expected) {
  if (seen.operator_stop) Raise(seen, EndReason::kOperatorStop);
  if (!seen.connected) Raise(seen, EndReason::kDriverLost);
  if (!seen.has_state) Raise(seen, EndReason::kStaleState);
  if (!seen.recorder_ok) Raise(seen, EndReason::kRecorderFailed);
  // In a move a driver may prepare its arm (test torques): then its states say that they are of a move.
  const bool preparing = moving_ && seen.state.moving;
  if (seen.connected && seen.has_state && seen.state.mode != expected && !preparing)
    Raise(seen, EndReason::kModeLost);
}

const SafetyMonitor::Position& SafetyMonitor::Past(int back) const {
  return history_[(newest_ + kHistory - back) % kHistory];
}

void SafetyMonitor::Remember(const RobotState& state) {
  const bool same = remembered_ > 0 && std::equal(state.q.begin(), state.q.begin() + n_, Past(0).q.begin());
  if (!same || remembered_ == 0) frozen_since_ns_ = state.stamp_ns;
  newest_ = (newest_ + 1) % kHistory;
  history_[newest_] = {state.stamp_ns, state.q};
  remembered_ = std::min(remembered_ + 1, kHistory);
  UpdateVelocity();
  if (same || !has_velocity_) return;
  speed_before_freeze_ = 0.0;
  for (int i = 0; i < n_; ++i) speed_before_freeze_ = std::max(speed_before_freeze_, std::abs(velocity_[i]));
}

void SafetyMonitor::UpdateVelocity() {
  for (int back = 1; back < remembered_; ++back) {
    const double dt = 1e-9 * static_cast<double>(Past(0).stamp_ns - Past(back).stamp_ns);
    const bool last_resort = back == kHistory - 1;  // a sensor faster than the window holds positions of
    if (dt < limits_.velocity_window_s && !last_resort) continue;
    for (int i = 0; i < n_; ++i) velocity_[i] = (Past(0).q[i] - Past(back).q[i]) / dt;
    has_velocity_ = true;
    return;
  }
}

bool SafetyMonitor::Velocity(double* v) const {
  if (has_velocity_) std::copy_n(velocity_.begin(), n_, v);
  return has_velocity_;
}

// The same to the last digit, in all joints: no sensor that measures a moving arm says that.
void SafetyMonitor::CheckFrozen(const Observation& seen) {
  const double frozen = 1e-9 * static_cast<double>(seen.state.stamp_ns - frozen_since_ns_);
  if (speed_before_freeze_ > kClearlyMoving && frozen > limits_.freeze_s)
    Raise(seen, EndReason::kFrozenState, -1, frozen, limits_.freeze_s);
  if (!told_to_move_) return;
  const double told = 1e-9 * static_cast<double>(seen.state.stamp_ns - told_since_ns_);
  if (std::min(frozen, told) > limits_.freeze_start_s)
    Raise(seen, EndReason::kFrozenState, -1, frozen, limits_.freeze_start_s);
}

void SafetyMonitor::WidenToStart(const Observation& seen) {
  for (int i = 0; i < n_; ++i) {
    const double q = seen.state.q[i];
    move_lower_[i] = q < limits_.lower[i] ? q - kOutsideSlack : limits_.lower[i];
    move_upper_[i] = q > limits_.upper[i] ? q + kOutsideSlack : limits_.upper[i];
  }
  for (int i = 0; i < 3; ++i) {
    const double lower = limits_.task.lower[i], upper = limits_.task.upper[i];
    const double x = seen.tip != nullptr ? seen.tip[i] : lower;
    move_tip_lower_[i] = x < lower ? x - kOutsideSlack : lower;
    move_tip_upper_[i] = x > upper ? x + kOutsideSlack : upper;
  }
  move_clearance_ = seen.clearance < 0.0 ? seen.clearance - kOutsideSlack : 0.0;
  has_start_ = true;
}

void SafetyMonitor::CheckStamp(const Observation& seen) {
  const double age = 1e-9 * static_cast<double>(seen.now_ns - seen.state.stamp_ns);
  const double oldest = moving_ ? kMovePatience * limits_.stale_s : limits_.stale_s;
  if (age > oldest) Raise(seen, EndReason::kStaleState, -1, age, oldest);
  const bool ahead = seen.state.stamp_ns > seen.now_ns + kFutureTolerance;
  const bool back = has_previous_ && seen.state.stamp_ns < previous_.stamp_ns;
  if (ahead || back) Raise(seen, EndReason::kImpossibleState, -1, age, 0.0);
}

void SafetyMonitor::CheckFinite(const Observation& seen) {
  for (int i = 0; i < n_; ++i) {
    if (!std::isfinite(seen.state.q[i])) Raise(seen, EndReason::kRobotNan, i, seen.state.q[i]);
    if (!std::isfinite(seen.state.v[i])) Raise(seen, EndReason::kRobotNan, i, seen.state.v[i]);
    if (!std::isfinite(seen.state.effort[i])) Raise(seen, EndReason::kRobotNan, i, seen.state.effort[i]);
  }
}

void SafetyMonitor::CheckJump(const Observation& seen) {
  if (!has_previous_ || seen.state.stamp_ns <= previous_.stamp_ns) return;
  const double dt = 1e-9 * static_cast<double>(seen.state.stamp_ns - previous_.stamp_ns);
  for (int i = 0; i < n_; ++i) {
    const double moved = std::abs(seen.state.q[i] - previous_.q[i]);
    const double possible = limits_.jump_ratio * limits_.velocity[i] * dt + limits_.jump_tolerance;
    if (moved > possible) Raise(seen, EndReason::kImpossibleState, i, moved, possible);
  }
}

void SafetyMonitor::CheckBoxes(const Observation& seen) {
  for (int i = 0; i < n_; ++i) {
    const double q = seen.state.q[i];
    const double lower = moving_ ? move_lower_[i] : limits_.lower[i];
    const double upper = moving_ ? move_upper_[i] : limits_.upper[i];
    if (q < lower) Raise(seen, EndReason::kPositionLimit, i, q, lower);
    if (q > upper) Raise(seen, EndReason::kPositionLimit, i, q, upper);
    const double v = velocity_[i];
    if (has_velocity_ && std::abs(v) > limits_.velocity[i])
      Raise(seen, EndReason::kVelocityLimit, i, v, limits_.velocity[i]);
  }
  const double nearest = moving_ ? move_clearance_ : 0.0;
  if (!(seen.clearance >= nearest))
    Raise(seen, EndReason::kSelfCollision, seen.nearest_pair, seen.clearance, nearest);
  if (!limits_.task.enabled || seen.tip == nullptr) return;
  for (int i = 0; i < 3; ++i) {
    const double x = seen.tip[i];
    const double lower = moving_ ? move_tip_lower_[i] : limits_.task.lower[i];
    const double upper = moving_ ? move_tip_upper_[i] : limits_.task.upper[i];
    if (!(x >= lower)) Raise(seen, EndReason::kTaskSpaceLimit, i, x, lower);
    if (!(x <= upper)) Raise(seen, EndReason::kTaskSpaceLimit, i, x, upper);
  }
}

void SafetyMonitor::CheckDeadlines(const Observation& seen) {
  consecutive_missed_ = seen.missed > 0 ? consecutive_missed_ + seen.missed : 0;
  missed_ += seen.missed;
  if (consecutive_missed_ >= limits_.max_consecutive_missed)
    Raise(seen, EndReason::kMissedDeadlines, -1, consecutive_missed_, limits_.max_consecutive_missed);
  const double elapsed = 1e-9 * static_cast<double>(seen.now_ns - first_tick_ns_);
  const double share = static_cast<double>(missed_) / static_cast<double>(ticks_ + missed_);
  if (elapsed >= 1.0 && share > limits_.max_missed_share)
    Raise(seen, EndReason::kMissedDeadlines, -1, share, limits_.max_missed_share);
}

void SafetyMonitor::Raise(const Observation& seen, EndReason reason, int joint, double value, double limit) {
  if (trip_.reason != EndReason::kNone) return;
  trip_ = Trip{reason, joint, value, limit, seen.now_ns};
}

bool SafetyMonitor::StateUsable(const Observation& seen) const {
  if (!seen.connected || !seen.has_state) return false;
  for (int i = 0; i < n_; ++i)
    if (!std::isfinite(seen.state.q[i])) return false;
  const double age = 1e-9 * static_cast<double>(seen.now_ns - seen.state.stamp_ns);
  return age <= limits_.stale_s && seen.state.mode == Mode::kTorque;
}

Action SafetyMonitor::AfterTrip(const Observation& seen) {
  const double since = 1e-9 * static_cast<double>(seen.now_ns - trip_.at_ns);
  // Gravity compensation at a position that cannot be true would throw the arm: hold at once.
  const bool usable = trip_.reason != EndReason::kImpossibleState && StateUsable(seen);
  if (since >= limits_.zero_torque_s || !usable) phase_ = Phase::kHold;
  return phase_ == Phase::kHold ? Action::kHold : Action::kZeroAdded;
}

std::string DescribeTrip(const Trip& trip, const std::vector<std::string>& joints) {
  const std::string joint =
      trip.joint >= 0 && trip.joint < static_cast<int>(joints.size()) ? joints[trip.joint] : "";
  switch (trip.reason) {
    case EndReason::kPositionLimit:
      return Printf("%s: position %.5g outside its limit %.5g", joint.c_str(), trip.value, trip.limit);
    case EndReason::kVelocityLimit:
      return Printf("%s: velocity %.5g beyond its limit %.5g", joint.c_str(), trip.value, trip.limit);
    case EndReason::kTorqueLimit:
      return Printf("%s: commanded %.5g beyond %.5g", joint.c_str(), trip.value, trip.limit);
    case EndReason::kTaskSpaceLimit:
      return Printf("end effector %c = %.4g m outside its limit %.4g m", "xyz"[std::clamp(trip.joint, 0, 2)],
                    trip.value, trip.limit);
    case EndReason::kControllerNan:
      return joint + ": the controller's command is not a finite number";
    case EndReason::kRobotNan:
      return joint + ": the measured state is not a finite number";
    case EndReason::kStaleState:
      if (trip.limit <= 0) return "no state was received";
      return Printf("newest state is %.3g s old, limit %.3g s", trip.value, trip.limit);
    case EndReason::kImpossibleState:
      if (joint.empty()) return "the state's time stamp goes back or lies in the future";
      return Printf("%s: moved %.4g between two states, at most %.4g is possible", joint.c_str(), trip.value,
                    trip.limit);
    case EndReason::kMissedDeadlines:
      if (trip.value < 1.0)
        return Printf("%.0f %% of the deadlines missed, limit %.0f %%", 100 * trip.value, 100 * trip.limit);
      return Printf("%.0f deadlines missed in a row, limit %.0f", trip.value, trip.limit);
    case EndReason::kSelfCollision:
      return Printf("parts of the arm that have to stay apart (pair %d) are %.4g m apart, limit %.4g m",
                    trip.joint + 1, trip.value, trip.limit);
    case EndReason::kControllerHung:
      return Printf("no command came for %.3g s, limit %.3g s", trip.value, trip.limit);
    case EndReason::kModeLost:
      return "the arm left its mode by itself";
    case EndReason::kFrozenState:
      return Printf(
          "positions stood still for %.3g s while their stamps advanced and the arm should have moved, "
          "limit %.3g s",
          trip.value, trip.limit);
    default:
      return "";
  }
}

}  // namespace rg::robot_agent
