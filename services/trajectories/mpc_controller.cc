#include "services/trajectories/mpc_controller.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "common/base/check.h"
#include "common/effects/inference.h"
#include "common/model/robot_model.h"

namespace rg::trajectories {
namespace {

// A plan whose search stalled with defects beyond this is none.
constexpr double kOpenDefect = 1e-3;

TrackingWeights WeightsOf(const MpcOptions& options, const Eigen::VectorXd& torque_limit) {
  if (options.weights.position.size() > 0) return options.weights;
  // Where there is no torque limit the effort weight falls back to that of 1 N·m.
  const Eigen::VectorXd scale =
      torque_limit.unaryExpr([](double limit) { return std::isfinite(limit) ? limit : 1.0; });
  return TrackingWeights::ForBandwidth(options.bandwidth, scale);
}

GnmsOptions SolverOptions(const MpcOptions& options) {
  GnmsOptions solver = options.solver;
  solver.max_iterations = std::max(options.cold_iterations, options.warm_iterations);
  solver.time_budget_s = options.time_budget_s;
  return solver;
}

bool HasDryFriction(const sim::Plant& plant) {
  return std::ranges::any_of(plant.effects(), [](const effects::EffectSpec& spec) {
    return effects::IsIn(effects::Slot::kDryFriction, spec.id);
  });
}

Status CheckWeights(const TrackingWeights& w, int n) {
  if (w.position.size() == 0) return Status::Ok();
  for (const Eigen::VectorXd* v :
       {&w.position, &w.velocity, &w.acceleration, &w.effort, &w.terminal_position, &w.terminal_velocity}) {
    if (v->size() != n)
      return InvalidError("mpc weights: " + std::to_string(v->size()) + " values for " + std::to_string(n) +
                          " joints");
    if (!(v->minCoeff() >= 0.0)) return InvalidError("mpc weights: a value is negative or not a number");
  }
  return Status::Ok();
}

Status CheckOptions(const sim::Plant& plant, const Eigen::VectorXd& values, const MpcOptions& o,
                    const Clock* clock) {
  const int n = plant.num_joints();
  if (values.size() != plant.parameters().size())
    return InvalidError("mpc: " + std::to_string(values.size()) + " parameter values, the plant has " +
                        std::to_string(plant.parameters().size()));
  if (!values.allFinite()) return InvalidError("mpc: a parameter value is not finite");
  auto positive = [](double value, const char* name) {
    return value > 0.0 && std::isfinite(value)
               ? Status::Ok()
               : InvalidError(std::string("mpc: ") + name + " = " + std::to_string(value) + ", must be > 0");
  };
  RG_RETURN_IF_ERROR(positive(o.interval_s, "interval_s"));
  RG_RETURN_IF_ERROR(positive(o.horizon_s, "horizon_s"));
  RG_RETURN_IF_ERROR(positive(o.bandwidth, "bandwidth"));
  if (o.knots() < 1 || o.knots() > 1000)
    return InvalidError("mpc: horizon of " + std::to_string(o.knots()) + " intervals, limits 1 and 1000");
  if (o.cold_iterations < 1 || o.warm_iterations < 1 || o.soft_iterations < 1)
    return InvalidError("mpc: iterations must be ≥ 1");
  if (!(o.soft_start >= 1.0) || !std::isfinite(o.soft_start))
    return InvalidError("mpc: soft_start = " + std::to_string(o.soft_start) + ", must be ≥ 1");
  if (!(o.position_margin >= 0.0) || !(o.velocity_margin >= 0.0 && o.velocity_margin < 1.0))
    return InvalidError("mpc: margins must be ≥ 0, the velocity's < 1");
  if (o.peak_torque.size() != 0 && (o.peak_torque.size() != n || !(o.peak_torque.minCoeff() > 0.0)))
    return InvalidError("mpc: peak_torque needs " + std::to_string(n) + " positive values");
  if (o.time_budget_s > 0.0 && clock == nullptr) return InvalidError("mpc: a time budget needs a clock");
  RG_RETURN_IF_ERROR(CheckWeights(o.weights, n));
  return sim::Simulator::Supports(MakePlanningModel(plant, values).plant, o.simulation);
}

}  // namespace

int MpcOptions::knots() const { return static_cast<int>(std::lround(horizon_s / interval_s)); }

Result<std::unique_ptr<MpcController>> MpcController::Create(const sim::Plant& plant,
                                                             const Eigen::VectorXd& values,
                                                             const MpcOptions& options, const Clock* clock) {
  RG_RETURN_IF_ERROR(CheckOptions(plant, values, options, clock));
  return std::unique_ptr<MpcController>(new MpcController(MakePlanningModel(plant, values), options, clock));
}

MpcController::MpcController(const PlanningModel& planning, const MpcOptions& options, const Clock* clock)
    : options_(options),
      n_(planning.plant.num_joints()),
      nx_(planning.plant.num_states()),
      encoder_offset_(planning.encoder_offset),
      limits_(MotionLimits::FromModel(planning.plant.model(), options.peak_torque)),
      simulator_(planning.plant, options.simulation),
      problem_(simulator_, options.knots(), options.interval_s,
               limits_.Tightened(options.position_margin, options.velocity_margin),
               WeightsOf(options, limits_.torque)),
      solver_(problem_, SolverOptions(options), clock) {
  simulator_.SetParameters(planning.values);
  if (options.soft_start > 1.0 && options.time_budget_s == 0.0 && HasDryFriction(planning.plant)) {
    sim::SimulatorOptions soft = options.simulation;
    soft.stick_velocity *= options.soft_start;
    soft_simulator_.emplace(planning.plant, soft);
    soft_simulator_->SetParameters(planning.values);
  }
  x0_ = Eigen::VectorXd::Zero(nx_);
  goal_ = true_goal_ = hold_torque_ = start_torque_ = Eigen::VectorXd::Zero(n_);
  guess_x_ = Eigen::MatrixXd::Zero(nx_, options.knots() + 1);
  guess_u_ = Eigen::MatrixXd::Zero(n_, options.knots());
}

MpcController::~MpcController() = default;

void MpcController::Reset() {
  cold_ = true;
  has_goal_ = false;
}

void MpcController::TakeGoal(const Eigen::VectorXd& goal) {
  if (has_goal_ && goal == goal_) return;
  goal_ = goal;
  has_goal_ = true;
  hold_residual_ = HoldTorque(simulator_, goal_, &hold_torque_);
  if (!hold_torque_.allFinite()) hold_torque_.setZero();
  problem_.SetGoal(goal_, hold_torque_);
}

// A straight line at the speed the joints allow, held by the torques of its ends.
void MpcController::GuessCold() {
  const int knots = options_.knots();
  double fastest = 0.0;  // s
  for (int i = 0; i < n_; ++i)
    if (std::isfinite(limits_.velocity[i]) && limits_.velocity[i] > 0.0)
      fastest = std::max(fastest, std::abs(goal_[i] - x0_[i]) / limits_.velocity[i]);
  const double duration = std::max(1.25 * fastest, 4.0 * options_.interval_s);
  if (!std::isfinite(HoldTorque(simulator_, x0_.head(n_), &start_torque_))) start_torque_ = hold_torque_;
  for (int k = 0; k <= knots; ++k) {
    const double share = std::min(k * options_.interval_s / duration, 1.0);
    guess_x_.col(k) = x0_;
    guess_x_.col(k).head(n_) += share * (goal_ - x0_.head(n_));
    if (k > 0) guess_x_.col(k).segment(n_, n_).setZero();
    if (k > 0 && share < 1.0) guess_x_.col(k).segment(n_, n_) = (goal_ - x0_.head(n_)) / duration;
    if (k < knots) guess_u_.col(k) = start_torque_ + share * (hold_torque_ - start_torque_);
  }
  solver_.SetGuess(guess_x_, guess_u_);
}

// From the cold guess to a plan with smoother friction, which the search goes on from. Returns its
// iterations.
int MpcController::SolveSoftly() {
  problem_.UseSimulator(*soft_simulator_);
  solver_.set_max_iterations(options_.soft_iterations);
  const GnmsSummary summary = solver_.Solve(x0_);
  problem_.UseSimulator(simulator_);
  if (summary.termination == Termination::kNonFinite) solver_.SetGuess(guess_x_, guess_u_);
  solver_.ForgetLinearization();
  return summary.iterations;
}

MpcStatus MpcController::Solve(const Eigen::VectorXd& q, const Eigen::VectorXd& v,
                               const Eigen::VectorXd& goal, Eigen::VectorXd* u) {
  RG_CHECK(q.size() == n_ && v.size() == n_) << q.size() << " positions, " << v.size() << " velocities";
  if (nx_ > 2 * n_) {
    if (cold_)
      x0_.tail(nx_ - 2 * n_) = simulator_.MakeState(q - encoder_offset_, v).z;
    else
      x0_.tail(nx_ - 2 * n_) = solver_.x(1).tail(nx_ - 2 * n_);
  }
  x0_.head(n_) = q - encoder_offset_;
  x0_.segment(n_, n_) = v;
  true_goal_ = goal - encoder_offset_;
  return SolveFrom(true_goal_, u);
}

MpcStatus MpcController::Solve(const sim::State& x, const Eigen::VectorXd& goal, Eigen::VectorXd* u) {
  RG_CHECK(x.q.size() == n_ && 2 * n_ + x.z.size() == nx_) << x.q.size() << " joints";
  x0_.head(n_) = x.q;
  x0_.segment(n_, n_) = x.v;
  x0_.tail(nx_ - 2 * n_) = x.z;
  return SolveFrom(goal, u);
}

Eigen::VectorXd MpcController::TorqueToReach(const Eigen::VectorXd& v) const {
  if (cold_) return Eigen::VectorXd::Zero(n_);
  const Eigen::PartialPivLU<Eigen::MatrixXd> velocity_by_torque(solver_.input_matrix().middleRows(n_, n_));
  const Eigen::VectorXd torque = velocity_by_torque.solve(v - solver_.predicted().segment(n_, n_));
  return torque.allFinite() ? torque : Eigen::VectorXd(Eigen::VectorXd::Zero(n_));
}

MpcStatus MpcController::SolveFrom(const Eigen::VectorXd& goal, Eigen::VectorXd* u) {
  RG_CHECK(goal.size() == n_) << goal.size();
  TakeGoal(goal);
  MpcStatus status;
  if (cold_) {
    GuessCold();
    if (soft_simulator_) status.iterations = SolveSoftly();
  } else {
    solver_.Shift();
  }
  solver_.set_max_iterations(cold_ ? options_.cold_iterations : options_.warm_iterations);
  const GnmsSummary summary = solver_.Solve(x0_);
  status.termination = summary.termination;
  status.iterations += summary.iterations;
  status.max_defect = summary.max_defect;
  status.max_violation = summary.max_violation;
  status.message = summary.message;
  const bool stalled_open = summary.termination == Termination::kStalled && summary.max_defect > kOpenDefect;
  status.ok = summary.termination != Termination::kNonFinite && !stalled_open;
  // A plan that failed is not built upon; the old one still gives this interval's control.
  *u = solver_.u(0);
  cold_ = !status.ok;
  if (!u->allFinite()) *u = hold_torque_;
  *u = u->cwiseMax(-limits_.torque).cwiseMin(limits_.torque);
  return status;
}

}  // namespace rg::trajectories
