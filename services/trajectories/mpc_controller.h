// Model predictive control: from state and goal to the torque of the next 40 ms.
//
// Every call solves the horizon again by Gauss-Newton multiple shooting, warm-started with the last
// plan moved one interval ahead. Runs live in the agent's control loop and, applied to its own model,
// makes the trajectories that the policy learns from. One thread; allocates only for a new goal, a cold
// start and the text of a failure.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <string>

#include "common/base/clock.h"
#include "common/base/status.h"
#include "common/sim/simulator.h"
#include "services/trajectories/gnms_solver.h"
#include "services/trajectories/plant_problem.h"

namespace rg::trajectories {

// MpcOptions::velocity_margin of what a robot is to execute, itself or by the policy learned from it: its safety monitor
// has the same limits.
inline constexpr double kRobotVelocityMargin = 0.05;

struct MpcOptions {
  double interval_s = 0.04;  // control interval: 25 Hz, the paper
  double horizon_s = 1.0;    // the paper; rounded to whole intervals
  // Integration inside an interval. Over 40 ms on trajectories of the Mico² the leapfrog at 10 ms errs by
  // at most 2.4e-4 rad and 8e-3 rad/s; the paper's Euler at 1 ms by 4.0e-4 rad and 1.3e-2 rad/s.
  // Dry friction is smoothed over ± stick_velocity: a plan needs to see that torque moves a joint which
  // sticks now. The plan's joints therefore creep by up to that under load; a robot's stick.
  sim::SimulatorOptions simulation{.step_s = 0.01, .stick_velocity = 0.05};

  // Natural frequency of the closed loop [rad/s], see TrackingWeights::ForBandwidth.
  double bandwidth = 8.0;
  // Overrides `bandwidth` when its vectors are not empty.
  TrackingWeights weights;

  // Caps the model's effort limits (n × 1); empty: the model's alone.
  Eigen::VectorXd peak_torque;
  // The plan keeps this far from the limits, so that what is executed holds them exactly.
  double position_margin = 0.01;  // rad or m
  double velocity_margin = 0.02;  // share of the limit

  int cold_iterations = 30;
  // Of a plant with an effect of dry friction a cold start first plans with friction smoothed over so many
  // times stick_velocity, for a few iterations: from a straight line alone many searches stall at the kinks.
  // On identified models of the Mico² 64 of 244 draws failed without it and 6 of 186 do with it. 1: not; nor
  // with a time budget.
  double soft_start = 6.0;
  int soft_iterations = 8;
  int warm_iterations = 2;  // per interval; the real-time iteration scheme uses 1
  GnmsOptions solver{.extra_iterations = 8,
                     .step_tolerance = 1e-4,
                     .defect_tolerance = 1e-4,
                     .decrease_tolerance = 1e-5,
                     .min_step = 1.0 / 32,
                     .regularization_max = 1e3};
  // 0: none. On the robot: what of the interval may be spent.
  double time_budget_s = 0.0;

  int knots() const;
};

struct MpcStatus {
  bool ok = false;  // u comes from a plan for this state; else from the last plan, or the hold torque
  Termination termination = Termination::kMaxIterations;
  int iterations = 0;
  double max_defect = 0.0;     // of the plan
  double max_violation = 0.0;  // of the plan's tightened joint boxes
  std::string message;         // empty when converged
};

class MpcController {
 public:
  // values: plant.parameters().size(). Refuses options that make no sense for this plant. `clock` is
  // needed when options.time_budget_s > 0.
  static Result<std::unique_ptr<MpcController>> Create(const sim::Plant& plant, const Eigen::VectorXd& values,
                                                       const MpcOptions& options,
                                                       const Clock* clock = nullptr);
  ~MpcController();

  int num_joints() const { return n_; }
  const MpcOptions& options() const { return options_; }
  // n, measured minus true position.
  const Eigen::VectorXd& encoder_offset() const { return encoder_offset_; }
  // Exact bounds (not the tightened ones of the plan).
  const MotionLimits& limits() const { return limits_; }
  // The simulator the plan is made with.
  sim::Simulator& simulator() { return simulator_; }

  // The next Solve starts cold.
  void Reset();

  // q, v, goal: as the encoders say it (n). Internal states of effects are predicted by the last plan. A new
  // goal (n) is taken over warm. u (n) is inside the torque box whatever happens.
  MpcStatus Solve(const Eigen::VectorXd& q, const Eigen::VectorXd& v, const Eigen::VectorXd& goal,
                  Eigen::VectorXd* u);
  // The same for a state and a goal of the planning plant, in true positions, internal states included.
  MpcStatus Solve(const sim::State& x, const Eigen::VectorXd& goal, Eigen::VectorXd* u);

  // The torque (n × 1) that, added to u of the last Solve over its interval, would have led to the velocity v (n × 1)
  // at the interval's end. Zero before the first plan, and where the last linearisation does not tell.
  Eigen::VectorXd TorqueToReach(const Eigen::VectorXd& v) const;
  // The plan of the last Solve: x(k), u(k).
  const GnmsSolver& plan() const { return solver_; }
  // Torque that holds the goal of the last Solve.
  const Eigen::VectorXd& hold_torque() const { return hold_torque_; }
  // What is left of the acceleration when holding it, see HoldTorque.
  double hold_residual() const { return hold_residual_; }

 private:
  MpcController(const PlanningModel& planning, const MpcOptions& options, const Clock* clock);
  MpcStatus SolveFrom(const Eigen::VectorXd& goal, Eigen::VectorXd* u);
  int SolveSoftly();
  void TakeGoal(const Eigen::VectorXd& goal);
  void GuessCold();

  MpcOptions options_;
  int n_, nx_;
  Eigen::VectorXd encoder_offset_;
  MotionLimits limits_;
  sim::Simulator simulator_;
  std::optional<sim::Simulator> soft_simulator_;
  PlantProblem problem_;
  GnmsSolver solver_;
  bool cold_ = true;
  bool has_goal_ = false;
  Eigen::VectorXd x0_, goal_, true_goal_, hold_torque_, start_torque_;
  double hold_residual_ = 0.0;
  Eigen::MatrixXd guess_x_, guess_u_;
};

}  // namespace rg::trajectories
