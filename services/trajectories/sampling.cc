#include "services/trajectories/sampling.h"

#include <cmath>

#include "common/base/check.h"

namespace rg::trajectories {
namespace {

std::string Number(double value) {
  std::string text = std::to_string(value);
  return text.substr(0, text.find('.') + 5);
}

Status CheckScalars(const SamplingOptions& o, int n, double duration_s) {
  if (!(duration_s > 0.0) || !std::isfinite(duration_s))
    return InvalidError("sampling: duration " + Number(duration_s) + " s, must be > 0");
  if (!(o.reach_fraction > 0.0)) return InvalidError("sampling: reach_fraction must be > 0");
  if (!(o.start_velocity_fraction >= 0.0 && o.start_velocity_fraction <= 1.0))
    return InvalidError("sampling: start_velocity_fraction must be in 0 … 1");
  if (!(o.position_margin >= 0.0)) return InvalidError("sampling: position_margin must be ≥ 0");
  if (!(o.continuous_range > 0.0) || !(o.home_range > 0.0))
    return InvalidError("sampling: ranges must be > 0");
  if (o.home.size() != 0 && (o.home.size() != n || !o.home.allFinite()))
    return InvalidError("sampling: home needs " + std::to_string(n) + " finite values");
  if (o.goal.size() != 0 && (o.goal.size() != n || !o.goal.allFinite()))
    return InvalidError("sampling: goal needs " + std::to_string(n) + " finite values");
  if (std::isfinite(o.home_range) && o.home.size() == 0)
    return InvalidError("sampling: home_range needs home");
  if (o.max_attempts < 1) return InvalidError("sampling: max_attempts must be ≥ 1");
  return Status::Ok();
}

}  // namespace

Result<StartGoalSampler> StartGoalSampler::Create(const model::RobotModel& model, const MotionLimits& limits,
                                                  double duration_s, const SamplingOptions& options) {
  const int n = model.num_joints();
  RG_RETURN_IF_ERROR(CheckScalars(options, n, duration_s));
  StartGoalSampler sampler(model);
  sampler.options_ = options;
  sampler.end_effector_ = *model.FindFrame(model.end_effector().name);
  sampler.lower_ = limits.position_lower;
  sampler.upper_ = limits.position_upper;
  sampler.velocity_ = limits.velocity;
  sampler.reach_ = options.reach_fraction * duration_s * limits.velocity;
  for (int i = 0; i < n; ++i) {
    const double home = options.home.size() > 0 ? options.home[i] : 0.0;
    double& low = sampler.lower_[i];
    double& high = sampler.upper_[i];
    low = std::isfinite(low) ? low + options.position_margin : home - options.continuous_range;
    high = std::isfinite(high) ? high - options.position_margin : home + options.continuous_range;
    low = std::max(low, home - options.home_range);
    high = std::min(high, home + options.home_range);
    if (!(low < high))
      return InvalidError("sampling: joint " + model.joint(i).name + ": empty range " + Number(low) + " … " +
                          Number(high));
    if (options.goal.size() > 0 && !(options.goal[i] >= low && options.goal[i] <= high))
      return InvalidError("sampling: goal " + Number(options.goal[i]) + " of joint " + model.joint(i).name +
                          " is outside the range " + Number(low) + " … " + Number(high));
    if (!std::isfinite(limits.velocity[i]) || !(limits.velocity[i] > 0.0))
      return InvalidError("sampling: joint " + model.joint(i).name + " has no velocity limit");
  }
  return sampler;
}

bool StartGoalSampler::HighEnough(const Eigen::VectorXd& q) {
  return dynamics::FramePose(mechanism_, workspace_, q, end_effector_).translation.z() >= options_.min_height;
}

void StartGoalSampler::DrawJoint(int i, Rng& rng, StartGoal* draw) const {
  if (options_.goal.size() > 0) {
    draw->goal[i] = options_.goal[i];
    draw->q[i] = rng.Uniform(std::max(lower_[i], draw->goal[i] - reach_[i]),
                             std::min(upper_[i], draw->goal[i] + reach_[i]));
    return;
  }
  // A uniform pair on the square has distance d with density ∝ width − d, and its lower end is then
  // uniform where both ends fit; drawn this way a short reach in a wide range costs few rejections.
  const double width = upper_[i] - lower_[i];
  const double reach = std::min(reach_[i], width);
  double distance;
  do {
    distance = rng.Uniform(0.0, reach);
  } while (rng.Uniform() * width > width - distance);
  const double low_end = rng.Uniform(lower_[i], upper_[i] - distance);
  const bool upwards = rng.Uniform() < 0.5;
  draw->q[i] = upwards ? low_end : low_end + distance;
  draw->goal[i] = upwards ? low_end + distance : low_end;
}

std::optional<StartGoal> StartGoalSampler::Draw(Rng& rng) {
  const int n = static_cast<int>(lower_.size());
  StartGoal draw{Eigen::VectorXd(n), Eigen::VectorXd(n), Eigen::VectorXd(n)};
  for (int attempt = 0; attempt < options_.max_attempts; ++attempt) {
    for (int i = 0; i < n; ++i) {
      DrawJoint(i, rng, &draw);
      draw.v[i] = options_.start_velocity_fraction * velocity_[i] * rng.Uniform(-1.0, 1.0);
    }
    if (std::isinf(options_.min_height)) return draw;
    if (HighEnough(draw.q) && HighEnough(draw.goal) && HighEnough(0.5 * (draw.q + draw.goal))) return draw;
  }
  return std::nullopt;
}

}  // namespace rg::trajectories
