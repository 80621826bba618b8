#include "services/rollouts/trust.h"

#include <algorithm>
#include <iterator>

namespace rg::rollouts {
namespace {

// How the fence ends a rollout (robot_agent/safety/monitor.h).
constexpr std::string_view kByTheFence[] = {
    "position_limit",   "velocity_limit", "torque_limit",     "task_space_limit", "controller_nan",
    "impossible_state", "frozen_state",   "missed_deadlines", "controller_hung",  "self_collision"};

// Of these, what a slower motion may avoid.
constexpr std::string_view kAvoidable[] = {"position_limit",   "velocity_limit",   "torque_limit",
                                           "task_space_limit", "missed_deadlines", "self_collision"};

template <class Reasons>
bool IsOneOf(std::string_view reason, const Reasons& reasons) {
  return std::find(std::begin(reasons), std::end(reasons), reason) != std::end(reasons);
}

}  // namespace

bool MayBeMadeAgain(std::string_view end_reason) { return IsOneOf(end_reason, kAvoidable); }

double TrustAfter(double trust, std::string_view end_reason, bool stop_confirmed) {
  if (!stop_confirmed) return 0.0;
  if (end_reason == "completed") return std::min(1.0, trust + kTrustStep);
  return IsOneOf(end_reason, kByTheFence) ? 0.5 * trust : trust;
}

double FirstRollouts::DurationOf(double asked_s, double trust) const {
  if (!on() || asked_s <= duration_s) return asked_s;
  return duration_s + std::clamp(trust, 0.0, 1.0) * (asked_s - duration_s);
}

double FirstRollouts::SpeedOf(double trust) const {
  return on() ? speed + std::clamp(trust, 0.0, 1.0) * (1.0 - speed) : 1.0;
}

}  // namespace rg::rollouts
