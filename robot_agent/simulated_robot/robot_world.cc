#include "robot_agent/simulated_robot/robot_world.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "robot_agent/arm_model.h"

namespace rg::robot_agent {
namespace {

sim::SimulatorOptions PhysicsOptions(const RobotTruth& truth) {
  sim::SimulatorOptions options;
  options.step_s = truth.physics_step_s;
  return options;
}

int64_t Nanos(double seconds) { return std::llround(1e9 * seconds); }

dynamics::Mechanism BelievedArm(const RobotTruth& truth) {
  if (truth.compensation == GravityCompensation::kNominal)
    return MechanismAt(truth.plant, truth.plant.parameters().Nominal());
  if (truth.compensation == GravityCompensation::kGiven)
    return MechanismAt(truth.plant, truth.compensation_values);
  return MechanismAt(truth.plant, truth.values);
}

// Rest to rest with zero acceleration at both ends: 10 s³ - 15 s⁴ + 6 s⁵.
constexpr double kPeakOfMinimumJerk = 1.875;

}  // namespace

RobotWorld::RobotWorld(const RobotTruth& truth, uint64_t seed)
    : truth_(truth),
      n_(truth.n()),
      cycle_ns_(Nanos(truth.step_s)),
      period_ns_(Nanos(1.0 / truth.rate_hz)),
      latency_ns_(Nanos(truth.latency_s)),
      simulator_(truth.plant, PhysicsOptions(truth)),
      true_arm_(MechanismAt(truth.plant, truth.values)),
      base_arm_(BelievedArm(truth)),
      noise_(seed),
      command_(Eigen::VectorXd::Zero(n_)),
      gravity_(n_),
      effort_(n_) {
  simulator_.SetParameters(truth.values);
  dynamics::GravityTorque(true_arm_, workspace_, truth.initial_pose, gravity_);
  effort_ = gravity_;
  x_ = simulator_.MakeState(truth.initial_pose, Eigen::VectorXd::Zero(n_), 0.0, &gravity_);
  SetPositionTarget(truth.initial_pose, 0.0);
}

DriverInfo RobotWorld::Info() const {
  DriverInfo info;
  info.robot = truth_.robot;
  info.joints = truth_.plant.joint_names();
  info.adds_gravity_compensation = truth_.compensation != GravityCompensation::kNone;
  info.silence_timeout_s = truth_.silence_timeout_s;
  info.state_rate_hz = truth_.rate_hz;
  info.position_stddev = truth_.position_stddev;
  info.velocity_stddev = truth_.velocity_stddev;
  info.position_resolution = truth_.position_resolution;
  return info;
}

void RobotWorld::EnterTorque(const double* first) {
  if (fault_refuse_) return;
  mode_ = Mode::kTorque;
  commands_.clear();
  command_ = Eigen::Map<const Eigen::VectorXd>(first, n_);
  last_heard_ns_ = time_ns_;
}

void RobotWorld::Torque(const double* tau) {
  Delayed command{.at_ns = time_ns_ + Nanos(truth_.command_latency_s)};
  std::copy_n(tau, n_, command.tau.begin());
  commands_.push_back(command);
  last_heard_ns_ = time_ns_;
}

void RobotWorld::Hold() {
  if (mode_ == Mode::kPosition && move_duration_s_ == 0.0) return;
  mode_ = Mode::kPosition;
  SetPositionTarget(x_.q, 0.0);
}

void RobotWorld::MoveTo(const double* q) {
  const Eigen::VectorXd target = Eigen::Map<const Eigen::VectorXd>(q, n_);
  mode_ = Mode::kPosition;
  const double longest = ((target - x_.q).array().abs() / truth_.speed.array()).maxCoeff();
  SetPositionTarget(target, kPeakOfMinimumJerk * longest);
}

void RobotWorld::SetPositionTarget(const Eigen::VectorXd& target, double duration_s) {
  from_ = reference_ = x_.q;
  target_ = target;
  reference_rate_ = Eigen::VectorXd::Zero(n_);
  move_start_ns_ = time_ns_;
  move_duration_s_ = duration_s;
}

void RobotWorld::Inject(Fault fault, double strength) {
  if (fault == Fault::kNan) fault_nan_ = true;
  if (fault == Fault::kJump) fault_jump_ = strength;
  if (fault == Fault::kRefuseTorque) fault_refuse_ = true;
  if (fault == Fault::kLeaveTorque) Hold();
}

void RobotWorld::AdvanceTo(int64_t time_ns) {
  while (time_ns_ + cycle_ns_ <= time_ns) Cycle();
}

void RobotWorld::Cycle() {
  if (time_ns_ >= next_measurement_ns_) Measure();
  TakeCommands();
  CheckSilence();
  const Eigen::VectorXd wanted = mode_ == Mode::kTorque ? TorqueControl() : PositionControl();
  const Eigen::VectorXd u = wanted.cwiseMax(-truth_.torque_limit).cwiseMin(truth_.torque_limit);
  if (failure_.empty()) {
    const sim::Outcome outcome = simulator_.Advance(x_, u, truth_.step_s);
    if (!outcome.ok()) failure_ = outcome.ToString();
  }
  const double share =
      truth_.effort_filter_s > 0 ? 1.0 - std::exp(-truth_.step_s / truth_.effort_filter_s) : 1.0;
  effort_ += share * (u - effort_);
  time_ns_ += cycle_ns_;
}

void RobotWorld::TakeCommands() {
  while (!commands_.empty() && commands_.front().at_ns <= time_ns_) {
    command_ = Eigen::Map<const Eigen::VectorXd>(commands_.front().tau.data(), n_);
    commands_.pop_front();
  }
}

void RobotWorld::CheckSilence() {
  if (mode_ != Mode::kTorque || time_ns_ - last_heard_ns_ <= Nanos(truth_.silence_timeout_s)) return;
  command_.setZero();
  if (truth_.silence_action == SilenceAction::kPositionMode) Hold();
}

Eigen::VectorXd RobotWorld::BelievedGravity(const Eigen::VectorXd& q) {
  Eigen::VectorXd gravity(n_);
  dynamics::GravityTorque(base_arm_, workspace_, q, gravity);
  return gravity;
}

Eigen::VectorXd RobotWorld::TorqueControl() {
  if (truth_.compensation == GravityCompensation::kNone) return command_;
  dynamics::GravityTorque(base_arm_, workspace_, x_.q, gravity_);
  return command_ + gravity_;
}

void RobotWorld::UpdateReference() {
  const double elapsed = 1e-9 * static_cast<double>(time_ns_ - move_start_ns_);
  if (elapsed >= move_duration_s_) {
    reference_ = target_;
    reference_rate_.setZero();
    return;
  }
  const double s = elapsed / move_duration_s_;
  const Eigen::VectorXd way = target_ - from_;
  reference_ = from_ + way * (s * s * s * (10.0 + s * (-15.0 + 6.0 * s)));
  reference_rate_ = way * (30.0 * s * s * (1.0 - s) * (1.0 - s) / move_duration_s_);
}

Eigen::VectorXd RobotWorld::PositionControl() {
  UpdateReference();
  dynamics::GravityTorque(true_arm_, workspace_, x_.q, gravity_);
  return gravity_ + truth_.stiffness.cwiseProduct(reference_ - x_.q) +
         truth_.damping.cwiseProduct(reference_rate_ - x_.v);
}

void RobotWorld::Measure() {
  next_measurement_ns_ += period_ns_;
  Eigen::VectorXd q(n_), v(n_);
  simulator_.Measure(x_, &q, &v);
  RobotState state;
  state.stamp_ns = time_ns_;
  state.sequence = ++sequence_;
  state.mode = mode_;
  const bool on_the_way = 1e-9 * static_cast<double>(time_ns_ - move_start_ns_) < move_duration_s_;
  state.moving = mode_ == Mode::kPosition && (on_the_way || x_.v.cwiseAbs().maxCoeff() > 0.02);
  for (int i = 0; i < n_; ++i) {
    state.q[i] = Quantised(q[i] + fault_jump_ + truth_.position_stddev * noise_.Normal());
    state.v[i] = truth_.velocity_gain[i] * v[i] + truth_.velocity_stddev * noise_.Normal();
    state.effort[i] = effort_[i] + truth_.effort_stddev * noise_.Normal();
  }
  if (fault_nan_) state.q[0] = std::numeric_limits<double>::quiet_NaN();
  in_flight_.push_back(state);
}

double RobotWorld::Quantised(double value) const {
  const double step = truth_.position_resolution;
  return step > 0 ? step * std::round(value / step) : value;
}

bool RobotWorld::TakeState(RobotState* state) {
  bool taken = false;
  while (!in_flight_.empty() && in_flight_.front().stamp_ns + latency_ns_ <= time_ns_) {
    newest_ = in_flight_.front();
    in_flight_.pop_front();
    has_newest_ = taken = true;
  }
  if (taken) *state = newest_;
  return taken;
}

bool RobotWorld::NewestState(RobotState* state) {
  TakeState(&newest_);
  if (has_newest_) *state = newest_;
  return has_newest_;
}

}  // namespace rg::robot_agent
