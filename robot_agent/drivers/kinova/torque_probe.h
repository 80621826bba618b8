// The test torque of one joint, as a pure state machine: what shows that torque mode is really on, that the
// joint answers, and in which direction.
//
//   watch (zero added torque) -> ramp (+rate N·m/s) -> moved, wrong sign, silent at the most, or drifting
//
// While watching, the joint's own drift is measured (the arm's gravity compensation has wrong masses);
// motion counts from where the drift would have taken it, so that drift is neither an answer nor a
// wrong sign. Torques are what is added to the arm's own compensation. No clock, no I/O. One thread.
#pragma once

#include <cstdint>

namespace rg::robot_agent::kinova {

struct ProbeOptions {
  double most_nm = 1.0;        // > 0: the ramp ends here
  double rate_nm_per_s = 2.0;  // > 0
  double motion_rad = 0.02;    // > 0: an answer
  double watch_s = 0.2;
  double wait_at_most_s = 0.3;    // a late answer at the most torque
  double drift_rad_per_s = 0.08;  // more drift than this: no test can be judged
  double direction = 1.0;         // +1 or -1: away from a near limit
};

enum class ProbeEnd : uint8_t { kGoingOn, kMoved, kWrongSign, kSilent, kDrifts };

class TorqueProbe {
 public:
  explicit TorqueProbe(const ProbeOptions& options) : options_(options) {}

  // With every new state, at time t [s] and angle q [rad].
  ProbeEnd Step(double t, double q);
  // To be sent now, N·m, signed; 0 when it has ended.
  double torque() const { return torque_; }
  // The greatest that was sent, ≥ 0, and the motion seen beyond the drift, positive along the torque.
  double reached_nm() const { return reached_; }
  double moved_rad() const { return moved_; }
  double drift_rad_per_s() const { return drift_; }

 private:
  ProbeEnd End(ProbeEnd how);

  const ProbeOptions options_;
  bool started_ = false, ended_ = false;
  ProbeEnd how_ = ProbeEnd::kGoingOn;
  double start_t_ = 0.0, start_q_ = 0.0;
  double ramp_t_ = -1.0, ramp_q_ = 0.0, most_t_ = -1.0;
  double drift_ = 0.0, torque_ = 0.0, reached_ = 0.0, moved_ = 0.0;
};

}  // namespace rg::robot_agent::kinova
