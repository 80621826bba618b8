#include "robot_agent/safety/monitor.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace rg::robot_agent {
namespace {

constexpr std::string_view kNames[] = {
    "none",          "completed",        "position_limit",   "velocity_limit",
    "torque_limit",  "task_space_limit", "controller_nan",   "robot_nan",
    "stale_state",   "impossible_state", "missed_deadlines", "driver_lost",
    "operator_stop", "recorder_failed",  "mode_lost",        "interrupted",
    "not_started"};

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

SafetyMonitor::SafetyMonitor(const SafetyLimits& limits, int n) : limits_(limits), n_(n) {}

Action SafetyMonitor::OnTick(const Observation& seen) {
  if (ticks_++ == 0) first_tick_ns_ = seen.now_ns;
  if (phase_ == Phase::kRunning) {
    CheckEverything(seen);
    if (trip_.reason == EndReason::kNone) {
      previous_ = seen.state;
      has_previous_ = true;
      return Action::kCommand;
    }
    phase_ = Phase::kZeroTorque;
  }
  return AfterTrip(seen);
}

Action SafetyMonitor::LimitCommand(double* tau, int64_t now_ns) {
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
  for (int i = 0; i < n_; ++i) {
    const double limited = std::clamp(tau[i], -limits_.torque[i], limits_.torque[i]);
    saturated |= limited != tau[i];
    tau[i] = limited;
  }
  saturated_ += saturated;
  return Action::kCommand;
}

// In the order of trust: whoever is not there cannot be judged by what it said.
void SafetyMonitor::CheckEverything(const Observation& seen) {
  CheckLiveness(seen);
  if (seen.has_state) {
    CheckStamp(seen);
    CheckFinite(seen);
    if (trip_.reason == EndReason::kNone) {
      CheckJump(seen);
      CheckBoxes(seen);
    }
  }
  CheckDeadlines(seen);
  if (seen.time_up) Raise(seen, EndReason::kCompleted);
}

void SafetyMonitor::CheckLiveness(const Observation& seen) {
  if (seen.operator_stop) Raise(seen, EndReason::kOperatorStop);
  if (!seen.connected) Raise(seen, EndReason::kDriverLost);
  if (!seen.has_state) Raise(seen, EndReason::kStaleState);
  if (!seen.recorder_ok) Raise(seen, EndReason::kRecorderFailed);
  if (seen.connected && seen.has_state && seen.state.mode != Mode::kTorque) Raise(seen, EndReason::kModeLost);
}

void SafetyMonitor::CheckStamp(const Observation& seen) {
  const double age = 1e-9 * static_cast<double>(seen.now_ns - seen.state.stamp_ns);
  if (age > limits_.stale_s) Raise(seen, EndReason::kStaleState, -1, age, limits_.stale_s);
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
    const double q = seen.state.q[i], v = seen.state.v[i];
    if (q < limits_.lower[i]) Raise(seen, EndReason::kPositionLimit, i, q, limits_.lower[i]);
    if (q > limits_.upper[i]) Raise(seen, EndReason::kPositionLimit, i, q, limits_.upper[i]);
    if (std::abs(v) > limits_.velocity[i]) Raise(seen, EndReason::kVelocityLimit, i, v, limits_.velocity[i]);
  }
  if (!limits_.task.enabled || seen.tip == nullptr) return;
  for (int i = 0; i < 3; ++i) {
    const double x = seen.tip[i];
    if (!(x >= limits_.task.lower[i])) Raise(seen, EndReason::kTaskSpaceLimit, i, x, limits_.task.lower[i]);
    if (!(x <= limits_.task.upper[i])) Raise(seen, EndReason::kTaskSpaceLimit, i, x, limits_.task.upper[i]);
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
  char text[160];
  const std::string joint =
      trip.joint >= 0 && trip.joint < static_cast<int>(joints.size()) ? joints[trip.joint] : "";
  switch (trip.reason) {
    case EndReason::kPositionLimit:
      std::snprintf(text, sizeof text, "%s: position %.5g outside its limit %.5g", joint.c_str(), trip.value,
                    trip.limit);
      return text;
    case EndReason::kVelocityLimit:
      std::snprintf(text, sizeof text, "%s: velocity %.5g beyond its limit %.5g", joint.c_str(), trip.value,
                    trip.limit);
      return text;
    case EndReason::kTorqueLimit:
      std::snprintf(text, sizeof text, "%s: commanded %.5g beyond %.5g", joint.c_str(), trip.value,
                    trip.limit);
      return text;
    case EndReason::kTaskSpaceLimit:
      std::snprintf(text, sizeof text, "end effector %c = %.4g m outside its limit %.4g m",
                    "xyz"[std::clamp(trip.joint, 0, 2)], trip.value, trip.limit);
      return text;
    case EndReason::kControllerNan:
      return joint + ": the controller's command is not a finite number";
    case EndReason::kRobotNan:
      return joint + ": the measured state is not a finite number";
    case EndReason::kStaleState:
      if (trip.limit <= 0) return "no state was received";
      std::snprintf(text, sizeof text, "newest state is %.3g s old, limit %.3g s", trip.value, trip.limit);
      return text;
    case EndReason::kImpossibleState:
      if (joint.empty()) return "the state's time stamp goes back or lies in the future";
      std::snprintf(text, sizeof text, "%s: moved %.4g between two states, at most %.4g is possible",
                    joint.c_str(), trip.value, trip.limit);
      return text;
    case EndReason::kMissedDeadlines:
      if (trip.value < 1.0)
        std::snprintf(text, sizeof text, "%.0f %% of the deadlines missed, limit %.0f %%", 100 * trip.value,
                      100 * trip.limit);
      else
        std::snprintf(text, sizeof text, "%.0f deadlines missed in a row, limit %.0f", trip.value,
                      trip.limit);
      return text;
    case EndReason::kModeLost:
      return "the arm left torque mode by itself";
    default:
      return "";
  }
}

}  // namespace rg::robot_agent
