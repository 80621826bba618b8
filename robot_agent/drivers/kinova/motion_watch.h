// Whether an arm that should be in torque mode has fallen back to position mode by itself: kinova-ros reports
// no mode, so it shows by an arm that stands still against a torque that proved enough to move it.
//
// Said when every joint has stayed within `still_rad` for `window_s` while one was asked throughout for more
// than its `strong_nm`, the same way. No clock, no allocation. One thread.
#pragma once

#include <cstdint>

#include "robot_agent/drivers/driver.h"

namespace rg::robot_agent::kinova {

struct MotionWatchOptions {
  int joints = 0;
  JointArray strong_nm{};    // added torque that a joint cannot resist
  double still_rad = 0.004;  // noise and resolution of the encoders below it
  double window_s = 0.5;
};

class MotionWatch {
 public:
  explicit MotionWatch(const MotionWatchOptions& options) : options_(options) {}

  void Restart() { started_ = false; }
  // A new state and the added torque in force; true: the arm ignores its torques.
  bool Step(int64_t time_ns, const JointArray& q, const JointArray& torque);

 private:
  void Begin(int64_t time_ns, const JointArray& q, const JointArray& torque);
  bool Still(const JointArray& q) const;

  const MotionWatchOptions options_;
  bool started_ = false;
  int64_t since_ns_ = 0;
  JointArray q_{};
  std::array<int8_t, kMaxJoints> pushed_{};  // +1, -1: asked that way since then; 0: not throughout
};

}  // namespace rg::robot_agent::kinova
