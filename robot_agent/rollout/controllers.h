// The controllers a rollout runs with: the trained policy, a table of torques, model predictive control.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <string>

#include "common/base/status.h"
#include "common/sim/plant.h"
#include "robot_agent/controller.h"
#include "robot_agent/drivers/driver.h"
#include "services/policy/policy.h"
#include "services/trajectories/reference_tracking.h"

namespace rg::robot_agent {

// tau = policy(q, v, goal). A policy that cannot evaluate (NaN in or out) yields NaN, so that the safety
// monitor stops the arm. Allocates nothing per command.
class PolicyController final : public Controller {
 public:
  // `goal`: n. Refuses a policy whose inputs are not 3n or whose joints are not `joints`.
  static Result<std::unique_ptr<PolicyController>> Create(policy::Policy policy,
                                                          const std::vector<std::string>& joints,
                                                          const Eigen::VectorXd& goal);
  // The goal that the policy is told moves evenly from `start` (n) to its own in the first `seconds`.
  void ApproachGoal(const Eigen::VectorXd& start, double seconds);
  void Command(double t, const double* q, const double* v, double* tau) override;

 private:
  PolicyController(policy::Policy policy, const Eigen::VectorXd& goal);

  const policy::Policy policy_;
  const int n_;
  const Eigen::VectorXd goal_;
  Eigen::VectorXd start_ = goal_;
  double approach_s_ = 0.0;
  std::array<double, 3 * kMaxJoints> input_{};
};

// A planned motion: torques held from their row's time to the next, after the last row the last one,
// optionally with a correction tau += gain_q ∘ (q_ref - q) + gain_v ∘ (v_ref - v).
class TrajectoryController final : public Controller {
 public:
  struct Plan {
    Eigen::VectorXd t;               // K, s, from the rollout's start, increasing
    Eigen::MatrixXd tau;             // n × K
    Eigen::MatrixXd q, v;            // n × K, needed with gains
    Eigen::VectorXd gain_q, gain_v;  // n, or empty: open loop
  };
  static Result<std::unique_ptr<TrajectoryController>> Create(Plan plan);
  void Command(double t, const double* q, const double* v, double* tau) override;

 private:
  explicit TrajectoryController(Plan plan) : plan_(std::move(plan)) {}
  Plan plan_;
};

// Follows a planned motion (services/trajectories/reference_tracking.h): held torques with feedback on
// position and velocity; after the last interval the arm is held where the motion ends. No allocation per
// command.
class TrackingController final : public Controller {
 public:
  explicit TrackingController(trajectories::TrackingPlan plan) : plan_(std::move(plan)) {}
  void Command(double t, const double* q, const double* v, double* tau) override;

 private:
  const trajectories::TrackingPlan plan_;
};

// Another controller's torques plus a small known motion of every joint, so that the recording tells
// friction and inertia also of joints that the controller leaves at rest:
//   tau_i += A_i · w(t) · Σ_{k=1..3} sin(2π f_ik t + φ_ik) / 3 ,  f in 0.2 … 1.5 Hz, drawn from `seed`
// w is 1 for the first half of duration_s, then falls smoothly to 0 at 0.7 of it, so that what comes
// after is the controller alone. |addition| ≤ A_i. No allocation per command.
class ExcitedController final : public Controller {
 public:
  // amplitude: n, N·m.
  ExcitedController(Controller& inner, const Eigen::VectorXd& amplitude, double duration_s, uint64_t seed);
  void Command(double t, const double* q, const double* v, double* tau) override;

 private:
  struct Sine {
    double angular_frequency = 0.0, phase = 0.0;
  };
  double Window(double t) const;

  Controller& inner_;
  const Eigen::VectorXd amplitude_;
  const double duration_s_;
  std::array<std::array<Sine, 3>, kMaxJoints> sines_{};
};

// Receding horizon on the believed model, solved anew each cycle, with an observer of the torque that the model misses.
// Plans keep `speed` of the velocity limits, in (0, 1]. Allocates.
Result<std::unique_ptr<Controller>> MakeMpcController(const sim::Plant& plant, const Eigen::VectorXd& values,
                                                      const Eigen::VectorXd& goal,
                                                      const Eigen::VectorXd& torque_limit, double rate_hz,
                                                      double speed = 1.0);

}  // namespace rg::robot_agent
