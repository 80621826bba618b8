#include "services/trajectories/plant_problem.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>

#include "common/base/check.h"

namespace rg::trajectories {
namespace {
constexpr double kUnbounded = std::numeric_limits<double>::infinity();

double ValueOf(const sim::Plant& plant, const Eigen::VectorXd& values, const std::string& name) {
  const int at = plant.parameters().Find(name);
  return at < 0 ? 0.0 : values[at];
}

// `id` on the joint with `value` more of its only parameter.
void AddOnJoint(const std::string& id, const std::string& parameter, const std::string& joint, double value,
                sim::Plant* plant, Eigen::VectorXd* values) {
  const std::string name = id + "." + joint + "." + parameter;
  if (plant->parameters().Find(name) < 0) {
    auto with = plant->WithEffect(effects::MakeSpec(id, {joint}));
    RG_CHECK(with.ok()) << with.status().ToString();
    *values = with->ValuesFrom(plant->parameters(), *values);
    *plant = *with;
    (*values)[plant->parameters().Find(name)] = 0.0;
  }
  (*values)[plant->parameters().Find(name)] += value;
}

}  // namespace

namespace {

// The motor of `transmission` (backlash, joint_elasticity) moves with its link.
void CarryMotors(const std::string& transmission, const sim::Plant& from, const Eigen::VectorXd& values,
                 PlanningModel* model) {
  for (const std::string& joint : from.joint_names()) {
    const std::string row = transmission + "." + joint + ".";
    if (from.parameters().Find(row + "motor_inertia") < 0) continue;
    AddOnJoint("rotor_inertia", "armature", joint, ValueOf(from, values, row + "motor_inertia"),
               &model->plant, &model->values);
    AddOnJoint("viscous_friction", "viscous", joint, ValueOf(from, values, row + "motor_viscous"),
               &model->plant, &model->values);
  }
}

}  // namespace

PlanningModel MakePlanningModel(const sim::Plant& plant, const Eigen::VectorXd& values) {
  sim::Plant planned = plant.WithoutEffect("actuator_delay")
                           .WithoutEffect("sensor_delay")
                           .WithoutEffect("external_disturbance")
                           .WithoutEffect("backlash");
  PlanningModel model{planned, planned.ValuesFrom(plant.parameters(), values),
                      Eigen::VectorXd::Zero(plant.num_joints())};
  for (int j = 0; j < plant.num_joints(); ++j) {
    const std::string& joint = plant.joint_names()[static_cast<size_t>(j)];
    model.encoder_offset[j] = ValueOf(plant, values, "encoder_offset." + joint + ".offset");
  }
  CarryMotors("backlash", plant, values, &model);
  return model;
}

PlanningModel WithStiffDrives(const PlanningModel& model) {
  sim::Plant stiff = model.plant.WithoutEffect("actuator_lag")
                         .WithoutEffect("torque_deadband")
                         .WithoutEffect("joint_elasticity");
  PlanningModel out{stiff, stiff.ValuesFrom(model.plant.parameters(), model.values), model.encoder_offset};
  CarryMotors("joint_elasticity", model.plant, model.values, &out);
  return out;
}

double HoldTorque(sim::Simulator& simulator, const Eigen::VectorXd& q, Eigen::VectorXd* u) {
  const int n = simulator.plant().num_joints();
  const Eigen::VectorXd rest = Eigen::VectorXd::Zero(n);
  auto acceleration = [&](const Eigen::VectorXd& torque, Eigen::VectorXd* a) {
    a->resize(n);
    const sim::State state = simulator.MakeState(q, rest, 0.0, &torque);
    return simulator.Acceleration(state, torque, a) && a->allFinite();
  };
  constexpr int kMaxNewtonSteps = 6;
  Eigen::VectorXd a(n), a_step(n);
  Eigen::MatrixXd da_du(n, n);
  *u = rest;
  double left = std::numeric_limits<double>::quiet_NaN();
  for (int step = 0; step <= kMaxNewtonSteps; ++step) {
    if (!acceleration(*u, &a)) return std::numeric_limits<double>::quiet_NaN();
    left = a.lpNorm<Eigen::Infinity>();
    if (left < 1e-9 || step == kMaxNewtonSteps) break;
    for (int j = 0; j < n; ++j) {  // linear in u for a rigid plant, so any width does
      Eigen::VectorXd moved = *u;
      moved[j] += 1.0;
      if (!acceleration(moved, &a_step)) return std::numeric_limits<double>::quiet_NaN();
      da_du.col(j) = a_step - a;
    }
    const Eigen::VectorXd next = *u - da_du.fullPivLu().solve(a);
    if (!next.allFinite()) break;
    *u = next;
  }
  return left;
}

PlantProblem::PlantProblem(sim::Simulator& simulator, int knots, double interval_s,
                           const MotionLimits& limits, const TrackingWeights& weights)
    : simulator_(&simulator),
      n_(simulator.plant().num_joints()),
      nx_(simulator.plant().num_states()),
      knots_(knots),
      interval_s_(interval_s),
      cost_(n_, nx_, interval_s, weights) {
  RG_CHECK(knots > 0 && interval_s > 0.0) << knots << " knots of " << interval_s << " s";
  RG_CHECK(limits.torque.size() == n_) << limits.torque.size() << " torque limits";
  u_lower_ = -limits.torque;
  u_upper_ = limits.torque;
  x_lower_ = Eigen::VectorXd::Constant(nx_, -kUnbounded);
  x_upper_ = Eigen::VectorXd::Constant(nx_, kUnbounded);
  x_lower_.head(n_) = limits.position_lower;
  x_upper_.head(n_) = limits.position_upper;
  x_lower_.segment(n_, n_) = -limits.velocity;
  x_upper_.segment(n_, n_) = limits.velocity;
  u_ = Eigen::VectorXd::Zero(n_);
  state_ = simulator.MakeState(u_, u_);
}

void PlantProblem::SetGoal(const VecIn& goal, const VecIn& hold_torque) {
  RG_CHECK(goal.size() == n_ && hold_torque.size() == n_) << goal.size();
  cost_.set_goal(goal);
  cost_.set_effort_reference(hold_torque);
}

bool PlantProblem::Advance(const VecIn& x, const VecIn& u, VecOut x_next, sim::Linearization* linearization) {
  state_.q = x.head(n_);
  state_.v = x.segment(n_, n_);
  state_.z = x.tail(nx_ - 2 * n_);
  state_.time = 0.0;  // drifts stand still over a horizon
  u_ = u;
  outcome_ = simulator_->Advance(state_, u_, interval_s_, linearization);
  if (!outcome_.ok()) return false;
  x_next.head(n_) = state_.q;
  x_next.segment(n_, n_) = state_.v;
  x_next.tail(nx_ - 2 * n_) = state_.z;
  return true;
}

bool PlantProblem::Step(int, const VecIn& x, const VecIn& u, VecOut x_next) {
  return Advance(x, u, x_next, nullptr);
}

bool PlantProblem::StepLinearized(int, const VecIn& x, const VecIn& u, VecOut x_next, MatOut A, MatOut B) {
  if (!Advance(x, u, x_next, &linearization_)) return false;
  A = linearization_.A;
  B = linearization_.B;
  return true;
}

std::string PlantProblem::StepError() const { return outcome_.ToString(); }

double PlantProblem::StageCost(int, const VecIn& x, const VecIn& u, const VecIn& x_next) {
  return cost_.Stage(x, u, x_next);
}

void PlantProblem::StageQuadratic(int, const VecIn& x, const VecIn& u, const VecIn& x_next, const MatIn& A,
                                  const MatIn& B, QuadraticCost* out) {
  cost_.StageQuadratic(x, u, x_next, A, B, out);
}

double PlantProblem::TerminalCost(const VecIn& x) { return cost_.Terminal(x); }

void PlantProblem::TerminalQuadratic(const VecIn& x, MatOut Q, VecOut q) { cost_.TerminalQuadratic(x, Q, q); }

}  // namespace rg::trajectories
