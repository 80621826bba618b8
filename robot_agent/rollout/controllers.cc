#include "robot_agent/rollout/controllers.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "common/base/rng.h"
#include "services/trajectories/mpc_controller.h"

namespace rg::robot_agent {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// Offset-free MPC (Pannocchia, Rawlings, AIChE J. 49, 2003): the torque that the model misses is estimated from how far
// each velocity falls from the prediction, and compensated. A belief without friction else asks for too little to move a
// joint at all, and the recording shows nothing of it.
class OffsetFreeMpc final : public Controller {
 public:
  OffsetFreeMpc(std::unique_ptr<trajectories::MpcController> mpc, const Eigen::VectorXd& goal)
      : mpc_(std::move(mpc)), goal_(goal), q_(goal.size()), v_(goal.size()) {
    u_ = applied_ = missing_ = Eigen::VectorXd::Zero(goal.size());
  }

  void Command(double, const double* q, const double* v, double* tau) override {
    const auto n = goal_.size();
    q_ = Eigen::Map<const Eigen::VectorXd>(q, n);
    v_ = Eigen::Map<const Eigen::VectorXd>(v, n);
    // What was applied is not what the prediction had: the compensation, as far as the limits let it through.
    missing_ += kObserverGain * (mpc_->TorqueToReach(v_) + u_ - applied_ - missing_);
    mpc_->Solve(q_, v_, goal_, &u_);
    const Eigen::VectorXd& limit = mpc_->limits().torque;
    applied_ = (u_ - missing_).cwiseMax(-limit).cwiseMin(limit);
    Eigen::Map<Eigen::VectorXd>(tau, n) = applied_;
  }

 private:
  // Share of the estimate's error that is taken up per interval: fast beside a motion, and stable by a factor of two
  // with a command that is late by one interval (z² − z + g has its poles inside the unit circle for g < 1).
  static constexpr double kObserverGain = 0.4;

  const std::unique_ptr<trajectories::MpcController> mpc_;
  const Eigen::VectorXd goal_;
  Eigen::VectorXd q_, v_, u_, applied_, missing_;
};

}  // namespace

Result<std::unique_ptr<PolicyController>> PolicyController::Create(policy::Policy policy,
                                                                   const std::vector<std::string>& joints,
                                                                   const Eigen::VectorXd& goal) {
  const auto n = static_cast<int>(joints.size());
  if (policy.input_size() != 3 * n || policy.output_size() != n)
    return InvalidError("the policy takes " + std::to_string(policy.input_size()) + " inputs and gives " +
                        std::to_string(policy.output_size()) + " torques, the robot needs " +
                        std::to_string(3 * n) + " and " + std::to_string(n));
  if (!policy.joints().empty() && policy.joints() != joints)
    return InvalidError("the policy was trained for other joints than the robot's (its first is " +
                        policy.joints().front() + ", the robot's " + joints.front() + ")");
  RG_CHECK(goal.size() == n) << goal.size();
  return std::unique_ptr<PolicyController>(new PolicyController(std::move(policy), goal));
}

PolicyController::PolicyController(policy::Policy policy, const Eigen::VectorXd& goal)
    : policy_(std::move(policy)), n_(static_cast<int>(goal.size())), goal_(goal) {}

void PolicyController::ApproachGoal(const Eigen::VectorXd& start, double seconds) {
  RG_CHECK(start.size() == n_) << start.size();
  start_ = start;
  approach_s_ = seconds;
}

void PolicyController::Command(double t, const double* q, const double* v, double* tau) {
  const double share = t < approach_s_ ? std::max(t, 0.0) / approach_s_ : 1.0;
  for (int i = 0; i < n_; ++i)
    input_[static_cast<size_t>(2 * n_ + i)] = start_[i] + share * (goal_[i] - start_[i]);
  std::copy_n(q, n_, input_.begin());
  std::copy_n(v, n_, input_.begin() + n_);
  const auto outcome =
      policy_.Evaluate({input_.data(), static_cast<size_t>(3 * n_)}, {tau, static_cast<size_t>(n_)});
  if (!outcome.ok()) std::fill_n(tau, n_, kNan);
}

Result<std::unique_ptr<TrajectoryController>> TrajectoryController::Create(Plan plan) {
  const auto count = plan.t.size();
  const bool feedback = plan.gain_q.size() > 0;
  if (count == 0 || plan.tau.cols() != count || !plan.tau.allFinite())
    return InvalidError("planned motion: needs one finite column of torques per time");
  for (Eigen::Index k = 1; k < count; ++k)
    if (!(plan.t[k] > plan.t[k - 1]))
      return InvalidError("planned motion: time does not grow at row " + std::to_string(k));
  const bool fits = plan.q.cols() == count && plan.v.cols() == count && plan.q.rows() == plan.tau.rows() &&
                    plan.v.rows() == plan.tau.rows() && plan.gain_q.size() == plan.tau.rows() &&
                    plan.gain_v.size() == plan.tau.rows();
  if (feedback && !fits)
    return InvalidError("planned motion: gains need positions and velocities of the same shape");
  return std::unique_ptr<TrajectoryController>(new TrajectoryController(std::move(plan)));
}

void TrajectoryController::Command(double t, const double* q, const double* v, double* tau) {
  const double* begin = plan_.t.data();
  const double* after = std::upper_bound(begin, begin + plan_.t.size(), t);
  const Eigen::Index k = std::max<Eigen::Index>(after - begin - 1, 0);
  for (Eigen::Index i = 0; i < plan_.tau.rows(); ++i) {
    tau[i] = plan_.tau(i, k);
    if (plan_.gain_q.size() == 0) continue;
    tau[i] += plan_.gain_q[i] * (plan_.q(i, k) - q[i]) + plan_.gain_v[i] * (plan_.v(i, k) - v[i]);
  }
}

void TrackingController::Command(double t, const double* q, const double* v, double* tau) {
  // The tick's own interval, though it may wake a little early or late.
  const auto tick = static_cast<Eigen::Index>(std::floor(t / plan_.interval_s + 0.5));
  const Eigen::Index k = std::clamp<Eigen::Index>(tick, 0, plan_.intervals() - 1);
  const Eigen::MatrixXd& gain = plan_.gain[static_cast<size_t>(k)];
  const Eigen::Index n = plan_.q.rows();
  for (Eigen::Index i = 0; i < n; ++i) {
    tau[i] = plan_.effort(i, k);
    for (Eigen::Index j = 0; j < n; ++j)
      tau[i] += gain(i, j) * (plan_.q(j, k) - q[j]) + gain(i, n + j) * (plan_.v(j, k) - v[j]);
  }
}

ExcitedController::ExcitedController(Controller& inner, const Eigen::VectorXd& amplitude, double duration_s,
                                     uint64_t seed)
    : inner_(inner), amplitude_(amplitude), duration_s_(duration_s) {
  RG_CHECK(amplitude.size() <= kMaxJoints);
  Rng rng(seed);
  for (Eigen::Index i = 0; i < amplitude.size(); ++i)
    for (Sine& sine : sines_[i])
      sine = {2.0 * std::numbers::pi * rng.Uniform(0.2, 1.5), rng.Uniform(0.0, 2.0 * std::numbers::pi)};
}

double ExcitedController::Window(double t) const {
  const double fall = std::clamp((t / duration_s_ - 0.5) / 0.2, 0.0, 1.0);
  return 0.5 + 0.5 * std::cos(std::numbers::pi * fall);
}

void ExcitedController::Command(double t, const double* q, const double* v, double* tau) {
  inner_.Command(t, q, v, tau);
  const double window = Window(t);
  for (Eigen::Index i = 0; i < amplitude_.size(); ++i) {
    double sum = 0.0;
    for (const Sine& sine : sines_[i]) sum += std::sin(sine.angular_frequency * t + sine.phase);
    tau[i] += amplitude_[i] * window * sum / 3.0;
  }
}

Result<std::unique_ptr<Controller>> MakeMpcController(const sim::Plant& plant, const Eigen::VectorXd& values,
                                                      const Eigen::VectorXd& goal,
                                                      const Eigen::VectorXd& torque_limit, double rate_hz,
                                                      double speed) {
  trajectories::MpcOptions options;
  options.velocity_margin = 1.0 - speed * (1.0 - trajectories::kRobotVelocityMargin);
  options.interval_s = 1.0 / rate_hz;
  options.peak_torque = torque_limit;
  RG_ASSIGN_OR_RETURN(auto mpc, trajectories::MpcController::Create(plant, values, options));
  return std::unique_ptr<Controller>(std::make_unique<OffsetFreeMpc>(std::move(mpc), goal));
}

}  // namespace rg::robot_agent
