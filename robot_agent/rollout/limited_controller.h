// Another controller's torques, made smaller where a joint would come too close to its velocity limit.
//
//   tau_i = g_i(q) + s_i (tau_inner,i − g_i(q)) ,  s_i = clip((b_i − |v_i|) / (a_i T), 0, 1) ,  b_i = share ·
//   v_max,i
//
// where s_i grows by at most ¼ from one command to the next.
// a_i is how fast |v_i| grew since the command before [rad/s²], T one control period and one command delay,
// g(q) the agent's own gravity torque. Only torques that drive a joint on in its direction are made smaller
// (v_i (tau_i − g_i) > 0). No model of the arm is believed: one that is wrong would hold back an arm that is
// slow, or let a fast one go. What it does not see is the growth of one period and delay, so a light joint
// may still pass its limit. What is not finite passes: the safety monitor stops the arm. Allocates nothing
// per command.
#pragma once

#include <Eigen/Core>

#include "robot_agent/controller.h"
#include "robot_agent/drivers/driver.h"
#include "robot_agent/safety/arm.h"

namespace rg::robot_agent {

struct VelocityShare {
  Eigen::VectorXd velocity;  // n, v_max of the safety monitor [rad/s or m/s]
  double share = 0.8;        // in (0, 1]
  double ahead_s = 0.06;     // T > 0 [s]
};

class LimitedController final : public Controller {
 public:
  // `inner` and `arm` must outlive it.
  LimitedController(Controller& inner, ArmModel& arm, VelocityShare limit);
  void Command(double t, const double* q, const double* v, double* tau) override;
  // Commands that were made smaller.
  int limited() const { return limited_; }

 private:
  Controller& inner_;
  ArmModel& arm_;
  const VelocityShare limit_;
  JointArray gravity_{}, speed_before_{}, share_before_{};
  double t_before_ = 0.0;
  bool has_before_ = false;
  int limited_ = 0;
};

}  // namespace rg::robot_agent
