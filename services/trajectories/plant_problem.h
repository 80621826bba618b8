// The optimal control problem of a plant: reach a joint-space goal, x = (q, v, z).
//
// Φ is sim::Simulator::Advance over one control interval with the torque held; A and B are its exact
// derivatives. What the plan leaves out: see PlanningModel.
#pragma once

#include <Eigen/Core>
#include <string>

#include "common/sim/simulator.h"
#include "services/trajectories/control_problem.h"
#include "services/trajectories/motion_limits.h"
#include "services/trajectories/tracking_cost.h"

namespace rg::trajectories {

// What is planned with: the plant without actuator_delay and sensor_delay, whose memory is not part of x,
// without external_disturbance, which belongs to the time of one recording, and without backlash, whose
// stiff faces no plan of 40 ms can follow: its motor moves with the link, as rotor inertia and viscous
// friction of the joint.
struct PlanningModel {
  sim::Plant plant;
  Eigen::VectorXd values;
  // n, measured minus true position: plans are in true positions, robots and policies in measured ones.
  Eigen::VectorXd encoder_offset;
};
PlanningModel MakePlanningModel(const sim::Plant& plant, const Eigen::VectorXd& values);
// The same without what stands between command and joint (lag, dead band, elasticity): torques act at once,
// elastic joints' motors move with their links.
PlanningModel WithStiffDrives(const PlanningModel& model);

// The torque u with which the plant rests at q: acceleration zero at v = 0 with internal states settled
// at u. Newton's method on the simulator's acceleration; exact after one step for a rigid plant. Returns
// the largest |acceleration| that is left [rad/s²]; NaN when the plant has none at q.
double HoldTorque(sim::Simulator& simulator, const Eigen::VectorXd& q, Eigen::VectorXd* u);

class PlantProblem final : public ControlProblem {
 public:
  // `simulator` (whose parameters are the model's) and the problem live in one thread; the simulator must
  // outlive the problem and its plant must be a PlanningModel's.
  PlantProblem(sim::Simulator& simulator, int knots, double interval_s, const MotionLimits& limits,
               const TrackingWeights& weights);

  // From here on steps are those of `simulator`, of the same plant and parameters with other options; it must
  // outlive the problem.
  void UseSimulator(sim::Simulator& simulator) { simulator_ = &simulator; }
  void SetGoal(const VecIn& goal, const VecIn& hold_torque);

  int num_joints() const { return n_; }
  double interval_s() const { return interval_s_; }

  int nx() const override { return nx_; }
  int nu() const override { return n_; }
  int knots() const override { return knots_; }
  bool Step(int k, const VecIn& x, const VecIn& u, VecOut x_next) override;
  bool StepLinearized(int k, const VecIn& x, const VecIn& u, VecOut x_next, MatOut A, MatOut B) override;
  std::string StepError() const override;
  double StageCost(int k, const VecIn& x, const VecIn& u, const VecIn& x_next) override;
  void StageQuadratic(int k, const VecIn& x, const VecIn& u, const VecIn& x_next, const MatIn& A,
                      const MatIn& B, QuadraticCost* out) override;
  double TerminalCost(const VecIn& x) override;
  void TerminalQuadratic(const VecIn& x, MatOut Q, VecOut q) override;
  const Eigen::VectorXd& u_lower() const override { return u_lower_; }
  const Eigen::VectorXd& u_upper() const override { return u_upper_; }
  const Eigen::VectorXd& x_lower() const override { return x_lower_; }
  const Eigen::VectorXd& x_upper() const override { return x_upper_; }

 private:
  bool Advance(const VecIn& x, const VecIn& u, VecOut x_next, sim::Linearization* linearization);

  sim::Simulator* simulator_;
  int n_, nx_, knots_;
  double interval_s_;
  TrackingCost cost_;
  sim::State state_;
  sim::Linearization linearization_;
  sim::Outcome outcome_;
  Eigen::VectorXd u_, u_lower_, u_upper_, x_lower_, x_upper_;
};

}  // namespace rg::trajectories
