#include "robot_agent/limited_controller.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "common/base/check.h"
#include "services/trajectories/plant_problem.h"

namespace rg::robot_agent {
namespace {

using trajectories::PlanningModel;

PlanningModel Immediate(const sim::Plant& plant, const Eigen::VectorXd& values) {
  return trajectories::WithStiffDrives(trajectories::MakePlanningModel(plant, values));
}

// The step that identification takes too: its parameters are of it.
constexpr double kStep_s = 0.002;

}  // namespace

LimitedController::LimitedController(Controller& inner, ArmModel& arm, const sim::Plant& plant,
                                     const Eigen::VectorXd& values, PredictedLimit limit)
    : inner_(inner),
      arm_(arm),
      limit_(std::move(limit)),
      encoder_offset_(Immediate(plant, values).encoder_offset),
      simulator_(Immediate(plant, values).plant, {.step_s = kStep_s}) {
  const Eigen::VectorXd zero = Eigen::VectorXd::Zero(plant.num_joints());
  RG_CHECK(limit_.velocity.size() == zero.size()) << limit_.velocity.size() << " velocity limits";
  RG_CHECK(limit_.ahead_s > 0.0) << limit_.ahead_s;
  simulator_.SetParameters(Immediate(plant, values).values);
  now_ = ahead_ = simulator_.MakeState(zero, zero);
  asked_ = hold_ = u_ = zero;
}

double LimitedController::PredictedExcess(const sim::State& from) {
  ahead_ = from;
  if (!simulator_.Advance(ahead_, u_, limit_.ahead_s).ok() || !ahead_.v.allFinite())
    return std::numeric_limits<double>::infinity();
  double excess = -1.0;
  for (Eigen::Index i = 0; i < u_.size(); ++i)
    excess = std::max(excess, std::abs(ahead_.v[i]) / (limit_.share * limit_.velocity[i]) - 1.0);
  return excess;
}

void LimitedController::Command(double t, const double* q, const double* v, double* tau) {
  inner_.Command(t, q, v, tau);
  const Eigen::Index n = asked_.size();
  asked_ = Eigen::Map<const Eigen::VectorXd>(tau, n);
  now_.q = Eigen::Map<const Eigen::VectorXd>(q, n) - encoder_offset_;
  now_.v = Eigen::Map<const Eigen::VectorXd>(v, n);
  if (!asked_.allFinite() || !now_.q.allFinite() || !now_.v.allFinite()) return;
  arm_.GravityTorque(q, gravity_.data());
  hold_ = Eigen::Map<const Eigen::VectorXd>(gravity_.data(), n);
  double best = 1.0, least = std::numeric_limits<double>::infinity();
  for (const double share : {1.0, 0.75, 0.5, 0.25, 0.0}) {
    u_ = hold_ + share * (asked_ - hold_);
    const double excess = PredictedExcess(now_);
    if (excess < least) best = share, least = excess;
    if (excess <= 0.0) break;
  }
  if (best == 1.0) return;
  ++limited_;
  for (Eigen::Index i = 0; i < n; ++i) tau[i] = hold_[i] + best * (asked_[i] - hold_[i]);
}

}  // namespace rg::robot_agent
