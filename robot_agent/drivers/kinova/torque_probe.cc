#include "robot_agent/drivers/kinova/torque_probe.h"

#include <algorithm>
#include <cmath>

namespace rg::robot_agent::kinova {

ProbeEnd TorqueProbe::End(ProbeEnd how) {
  ended_ = true;
  torque_ = 0.0;
  return how_ = how;
}

ProbeEnd TorqueProbe::Step(double t, double q) {
  if (ended_) return how_;
  if (!started_) {
    started_ = true;
    start_t_ = t;
    start_q_ = q;
    return ProbeEnd::kGoingOn;
  }
  if (ramp_t_ < 0.0) {
    if (t - start_t_ < options_.watch_s) return ProbeEnd::kGoingOn;
    drift_ = (q - start_q_) / (t - start_t_);
    if (std::abs(drift_) > options_.drift_rad_per_s) return End(ProbeEnd::kDrifts);
    ramp_t_ = t;
    ramp_q_ = q;
  }
  moved_ = options_.direction * (q - ramp_q_ - drift_ * (t - ramp_t_));
  if (moved_ >= options_.motion_rad) return End(ProbeEnd::kMoved);
  if (moved_ <= -options_.motion_rad) return End(ProbeEnd::kWrongSign);
  const double size = std::min(options_.rate_nm_per_s * (t - ramp_t_), options_.most_nm);
  if (most_t_ < 0.0 && size >= options_.most_nm) most_t_ = t;
  if (most_t_ >= 0.0 && t - most_t_ > options_.wait_at_most_s) return End(ProbeEnd::kSilent);
  reached_ = std::max(reached_, size);
  torque_ = options_.direction * size;
  return ProbeEnd::kGoingOn;
}

}  // namespace rg::robot_agent::kinova
