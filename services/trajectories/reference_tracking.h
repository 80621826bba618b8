// Following a motion under torque control at a low rate: for each interval the torque that the model needs
// for it, and a linear feedback on position and velocity.
//
//   tau = u_k + K_k ((q_ref, v_ref)_k − (q, v))
//
// u_k: inverse dynamics at the interval's middle, effects included, drives and transmissions taken as stiff.
// K_k: the linear-quadratic regulator along the motion, of the exact derivatives of the step over an
// interval; so a model that is nearly right is followed stably also by light joints at 25 Hz.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "common/sim/plant.h"
#include "services/trajectories/motion_limits.h"

namespace rg::trajectories {

// Position, velocity and acceleration (n each) that encoders should say at a time.
using MotionFn = std::function<void(double t, Eigen::VectorXd* q, Eigen::VectorXd* v, Eigen::VectorXd* a)>;

struct TrackingPlan {
  double interval_s = 0.04;
  Eigen::MatrixXd q, v, effort;       // n × K, at the intervals' beginnings; effort held over them
  std::vector<Eigen::MatrixXd> gain;  // K of n × 2n
  int intervals() const { return static_cast<int>(gain.size()); }
};

// Errors: no torque makes the model follow (time, joint), or one beyond `torque_limit` (n, may be infinite):
// the line names joint, time, torque and limit.
Result<TrackingPlan> PlanTracking(const sim::Plant& plant, const Eigen::VectorXd& values,
                                  const MotionFn& motion, double duration_s, double interval_s,
                                  const Eigen::VectorXd& torque_limit);

}  // namespace rg::trajectories
