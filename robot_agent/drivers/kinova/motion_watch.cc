#include "robot_agent/drivers/kinova/motion_watch.h"

#include <cmath>

namespace rg::robot_agent::kinova {
namespace {
int8_t Way(double torque, double strong) { return torque > strong ? 1 : torque < -strong ? -1 : 0; }
}  // namespace

void MotionWatch::Begin(int64_t time_ns, const JointArray& q, const JointArray& torque) {
  started_ = true;
  since_ns_ = time_ns;
  q_ = q;
  for (int i = 0; i < options_.joints; ++i) pushed_[i] = Way(torque[i], options_.strong_nm[i]);
}

bool MotionWatch::Still(const JointArray& q) const {
  for (int i = 0; i < options_.joints; ++i)
    if (!(std::abs(q[i] - q_[i]) <= options_.still_rad)) return false;
  return true;
}

bool MotionWatch::Step(int64_t time_ns, const JointArray& q, const JointArray& torque) {
  if (!started_ || !Still(q)) {
    Begin(time_ns, q, torque);
    return false;
  }
  bool pushed = false;
  for (int i = 0; i < options_.joints; ++i) {
    if (pushed_[i] != Way(torque[i], options_.strong_nm[i])) pushed_[i] = 0;
    pushed |= pushed_[i] != 0;
  }
  if (!pushed) {
    Begin(time_ns, q, torque);
    return false;
  }
  return 1e-9 * static_cast<double>(time_ns - since_ns_) >= options_.window_s;
}

}  // namespace rg::robot_agent::kinova
