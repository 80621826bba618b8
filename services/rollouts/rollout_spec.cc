#include "services/rollouts/rollout_spec.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <set>
#include <vector>

namespace rg::rollouts {
namespace {

using nlohmann::json;

constexpr double kMargin = 0.05;  // rad (m), of goals to the safety box
constexpr double kSpeedShare = 0.6;

Eigen::VectorXd ReadVector(const json& value) {
  const auto values = value.get<std::vector<double>>();
  return Eigen::Map<const Eigen::VectorXd>(values.data(), static_cast<Eigen::Index>(values.size()));
}

std::vector<double> ToVector(const Eigen::VectorXd& x) { return {x.data(), x.data() + x.size()}; }

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

Result<RolloutSpec> ParseSpec(const std::string& text) {
  static const std::set<std::string> kKnown{"format",       "id",         "rate_hz",       "duration_s",
                                            "start",        "goal",       "goal_position", "goal_seed",
                                            "goal_reach_s", "excitation", "robot_seed"};
  RolloutSpec spec;
  try {
    const json root = json::parse(text);
    for (const auto& [key, value] : root.items())
      if (!kKnown.contains(key)) return InvalidError("rollout spec: unknown field \"" + key + "\"");
    if (root.at("format") != kSpecFormat)
      return InvalidError("rollout spec: format is " + root.at("format").dump() + ", needs " + kSpecFormat);
    root.at("id").get_to(spec.id);
    spec.rate_hz = root.value("rate_hz", spec.rate_hz);
    spec.duration_s = root.value("duration_s", spec.duration_s);
    spec.goal_seed = root.value("goal_seed", spec.goal_seed);
    spec.goal_reach_s = root.value("goal_reach_s", spec.goal_reach_s);
    spec.excitation = root.value("excitation", spec.excitation);
    spec.robot_seed = root.value("robot_seed", spec.robot_seed);
    if (root.contains("start")) spec.start = ReadVector(root["start"]);
    if (root.contains("goal")) spec.goal = ReadVector(root["goal"]);
    if (root.contains("goal_position")) spec.goal_position = ReadVector(root["goal_position"]);
  } catch (const json::exception& error) {
    return InvalidError(std::string("rollout spec: ") + error.what());
  }
  RG_RETURN_IF_ERROR(CheckSpec(spec));
  return spec;
}

std::string SpecToJson(const RolloutSpec& spec) {
  json root{{"format", kSpecFormat},         {"id", spec.id},
            {"rate_hz", spec.rate_hz},       {"duration_s", spec.duration_s},
            {"goal_seed", spec.goal_seed},   {"goal_reach_s", spec.goal_reach_s},
            {"excitation", spec.excitation}, {"robot_seed", spec.robot_seed}};
  if (spec.start.size() > 0) root["start"] = ToVector(spec.start);
  if (spec.goal.size() > 0) root["goal"] = ToVector(spec.goal);
  if (spec.goal_position.size() > 0) root["goal_position"] = ToVector(spec.goal_position);
  return root.dump();
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
