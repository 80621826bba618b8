#include "robot_agent/rollout/limited_controller.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "common/base/check.h"

namespace rg::robot_agent {
namespace {

constexpr double kRecovery = 0.25;  // by which s_i may grow from one command to the next

}  // namespace

LimitedController::LimitedController(Controller& inner, ArmModel& arm, VelocityShare limit)
    : inner_(inner), arm_(arm), limit_(std::move(limit)) {
  RG_CHECK(limit_.ahead_s > 0.0) << limit_.ahead_s;
  share_before_.fill(1.0);
}

void LimitedController::Command(double t, const double* q, const double* v, double* tau) {
  inner_.Command(t, q, v, tau);
  arm_.GravityTorque(q, gravity_.data());
  const double dt = t - t_before_;
  bool smaller = false;
  for (Eigen::Index i = 0; i < limit_.velocity.size(); ++i) {
    const auto joint = static_cast<size_t>(i);
    const double speed = std::abs(v[i]), room = limit_.share * limit_.velocity[i] - speed;
    const double growth = has_before_ && dt > 0.0 ? (speed - speed_before_[joint]) / dt : 0.0;
    const double added = tau[i] - gravity_[joint];
    speed_before_[joint] = speed;
    double share = std::min(1.0, share_before_[joint] + kRecovery);
    if (!(growth * limit_.ahead_s <= room))
      share = std::min(share, growth > 0.0 ? std::clamp(room / (growth * limit_.ahead_s), 0.0, 1.0) : 0.0);
    share_before_[joint] = share;
    if (share == 1.0 || !(added * v[i] > 0.0)) continue;
    tau[i] = gravity_[joint] + share * added;
    smaller = true;
  }
  t_before_ = t, has_before_ = true;
  limited_ += smaller;
}

}  // namespace rg::robot_agent
