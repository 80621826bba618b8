#include "services/rollouts/rollout_spec.h"

#include <algorithm>
#include <cmath>

namespace rg::rollouts {
namespace {

constexpr double kMargin = 0.05;  // rad (m), of goals to the safety box
constexpr double kSpeedShare = 0.6;

Status CheckRange(const char* field, double value, double low, double high) {
  if (std::isfinite(value) && value >= low && value <= high) return Status::Ok();
  return InvalidError(std::string("rollout spec: ") + field + " is " + std::to_string(value) + ", needs " +
                      std::to_string(low) + " to " + std::to_string(high));
}

Status CheckId(const std::string& id) {
  const bool plain = !id.empty() && id.size() <= 80 && id[0] != '.' &&
                     std::all_of(id.begin(), id.end(), [](unsigned char c) {
                       return std::isalnum(c) || c == '-' || c == '_' || c == '.';
                     });
  if (plain) return Status::Ok();
  return InvalidError("rollout spec: id \"" + id + "\" needs 1 to 80 letters, digits, '-', '_' or '.'");
}

}  // namespace

Status CheckSpec(const RolloutSpec& spec) {
  RG_RETURN_IF_ERROR(CheckId(spec.id));
  RG_RETURN_IF_ERROR(CheckRange("rate_hz", spec.rate_hz, 1, 1000));
  RG_RETURN_IF_ERROR(CheckRange("duration_s", spec.duration_s, 0.1, 600));
  RG_RETURN_IF_ERROR(CheckRange("goal_reach_s", spec.goal_reach_s, 1e-3, 600));
  RG_RETURN_IF_ERROR(CheckRange("excitation", spec.excitation, -1, 1));
  if (!spec.start.allFinite()) return InvalidError("rollout spec: start is not finite");
  if (!spec.goal.allFinite()) return InvalidError("rollout spec: goal is not finite");
  const auto place = spec.goal_position.size();
  if ((place != 0 && place != 3) || !spec.goal_position.allFinite())
    return InvalidError("rollout spec: goal_position needs three finite numbers");
  return Status::Ok();
}

Eigen::VectorXd SampleGoal(const model::RobotModel& model, const Eigen::VectorXd& start,
                           const Eigen::VectorXd& lower, const Eigen::VectorXd& upper, double reach_s,
                           Rng& rng) {
  const int n = model.num_joints();
  RG_CHECK(start.size() == n && lower.size() == n && upper.size() == n && reach_s > 0);
  const Eigen::VectorXd reach = kSpeedShare * reach_s * model.VelocityLimits();
  Eigen::VectorXd goal = start;
  for (int attempt = 0; attempt < 100; ++attempt) {
    double largest_share = 0.0;
    for (int i = 0; i < n; ++i) {
      const double low = std::max(start[i] - reach[i], lower[i] + kMargin);
      const double high = std::min(start[i] + reach[i], upper[i] - kMargin);
      goal[i] = low < high ? rng.Uniform(low, high) : start[i];
      largest_share = std::max(largest_share, std::abs(goal[i] - start[i]) / reach[i]);
    }
    if (largest_share >= 0.5) break;
  }
  return goal;
}

}  // namespace rg::rollouts
