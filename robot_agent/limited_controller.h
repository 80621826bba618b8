// Another controller's torques, made smaller where the believed model says that the arm would come too close to a
// velocity limit of the safety monitor.
//
//   tau = g(q) + s (tau_inner − g(q)) ,  s the largest of 1, ¾, ½, ¼, 0 whose state one control period and one
//   command delay ahead has |v_i| ≤ share · v_max,i on every joint; where none has, the one of least excess
//
// g(q) is the agent's own gravity torque, the prediction one step of the believed model without lags and delays.
// A command that is not finite passes as it is: the monitor stops the arm. Allocates nothing per command.
#pragma once

#include <Eigen/Core>

#include "common/sim/simulator.h"
#include "robot_agent/arm_model.h"
#include "robot_agent/controller.h"
#include "robot_agent/drivers/driver.h"

namespace rg::robot_agent {

struct PredictedLimit {
  Eigen::VectorXd velocity;    // n, of the safety monitor [rad/s or m/s]
  double share = 0.8;          // of it that a prediction may reach, in (0, 1]
  double ahead_s = 0.04;       // > 0: one period and one command delay
};

class LimitedController final : public Controller {
 public:
  // `values`: of the plant's parameters. `inner` and `arm` must outlive it.
  LimitedController(Controller& inner, ArmModel& arm, const sim::Plant& plant, const Eigen::VectorXd& values,
                    PredictedLimit limit);
  void Command(double t, const double* q, const double* v, double* tau) override;
  // Commands that were made smaller.
  int limited() const { return limited_; }

 private:
  // Largest |v_i| / (share · v_max,i) − 1 after ahead_s under u_; infinite where the model breaks down.
  double PredictedExcess(const sim::State& from);

  Controller& inner_;
  ArmModel& arm_;
  const PredictedLimit limit_;
  Eigen::VectorXd encoder_offset_;
  sim::Simulator simulator_;
  sim::State now_, ahead_;
  Eigen::VectorXd asked_, hold_, u_;
  JointArray gravity_{};
  int limited_ = 0;
};

}  // namespace rg::robot_agent
