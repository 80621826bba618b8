#include "robot_agent/safety/limits.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "common/base/json_fields.h"
#include "common/base/printf.h"

namespace rg::robot_agent {
namespace {

using nlohmann::json;

std::string Num(double value) { return Printf("%.6g", value); }

Status CheckSize(const char* field, const std::vector<double>& values, size_t n) {
  if (values.size() == n) return Status::Ok();
  return InvalidError(std::string("safety limits: ") + field + " has " + std::to_string(values.size()) +
                      " entries for " + std::to_string(n) + " joints");
}

Status CheckAtLeast(const char* field, double value, double lowest) {
  if (std::isfinite(value) && value >= lowest) return Status::Ok();
  return InvalidError(std::string("safety limits: ") + field + " is " + Num(value) + ", needs at least " +
                      Num(lowest));
}

Status CheckPositive(const char* field, const std::vector<double>& values,
                     const std::vector<std::string>& joints) {
  for (size_t i = 0; i < joints.size(); ++i) {
    if (std::isfinite(values[i]) && values[i] > 0) continue;
    return InvalidError(std::string("safety limits: ") + field + " of " + joints[i] + " is " +
                        Num(values[i]) + ", must be positive and finite");
  }
  return Status::Ok();
}

Status CheckPositionBox(const SafetyLimits& limits, const std::vector<std::string>& joints,
                        const std::vector<double>& start) {
  for (size_t i = 0; i < joints.size(); ++i) {
    const double lower = limits.lower[i], upper = limits.upper[i];
    if (!std::isfinite(lower) || !std::isfinite(upper) || lower >= upper)
      return InvalidError("safety limits: position box of " + joints[i] + " is [" + Num(lower) + ", " +
                          Num(upper) + "], needs finite lower < upper");
    if (!start.empty() && (start[i] < lower || start[i] > upper))
      return InvalidError("safety limits: the start pose has " + joints[i] + " at " + Num(start[i]) +
                          ", outside its box [" + Num(lower) + ", " + Num(upper) + "]");
  }
  return Status::Ok();
}

Status CheckTaskBox(const TaskBox& box) {
  if (!box.enabled) return Status::Ok();
  for (int i = 0; i < 3; ++i) {
    if (std::isfinite(box.lower[i]) && std::isfinite(box.upper[i]) && box.lower[i] < box.upper[i]) continue;
    return InvalidError(std::string("safety limits: task box along ") + "xyz"[i] + " is [" +
                        Num(box.lower[i]) + ", " + Num(box.upper[i]) + "], needs finite lower < upper");
  }
  return Status::Ok();
}

Status ReadTaskBox(const json& value, TaskBox* box) {
  if (value.is_null()) return Status::Ok();
  const auto lower = value.at("lower").get<std::vector<double>>();
  const auto upper = value.at("upper").get<std::vector<double>>();
  if (lower.size() != 3 || upper.size() != 3)
    return InvalidError("task_box needs lower and upper of three numbers");
  for (int i = 0; i < 3; ++i) box->lower[i] = lower[i], box->upper[i] = upper[i];
  box->enabled = true;
  return Status::Ok();
}

Status ReadFields(const json& root, SafetyLimits* limits) {
  JsonFields fields(
      root,
      "lower upper velocity torque torque_rate velocity_window_s freeze_s freeze_start_s task_box "
      "torque_trip_ratio stale_s jump_ratio jump_tolerance max_consecutive_missed max_missed_share "
      "zero_torque_s");
  fields.Require("lower", &limits->lower, "the lowest position of each joint, rad (m)");
  fields.Require("upper", &limits->upper, "the highest position of each joint, rad (m)");
  fields.Require("velocity", &limits->velocity, "the largest speed of each joint, rad/s (m/s)");
  fields.Require("torque", &limits->torque, "the largest torque of each joint, N·m (N)");
  fields.Require("torque_rate", &limits->torque_rate,
                 "how fast the torque of each joint may change, N·m/s (N/s)");
  json box;
  fields.Require(
      "task_box", &box,
      "where the end effector may be, {\"lower\": [3], \"upper\": [3]} in m, or null for anywhere");
  fields.Read("velocity_window_s", &limits->velocity_window_s);
  fields.Read("freeze_s", &limits->freeze_s);
  fields.Read("freeze_start_s", &limits->freeze_start_s);
  fields.Read("torque_trip_ratio", &limits->torque_trip_ratio);
  fields.Read("stale_s", &limits->stale_s);
  fields.Read("jump_ratio", &limits->jump_ratio);
  fields.Read("jump_tolerance", &limits->jump_tolerance);
  fields.Read("max_consecutive_missed", &limits->max_consecutive_missed);
  fields.Read("max_missed_share", &limits->max_missed_share);
  fields.Read("zero_torque_s", &limits->zero_torque_s);
  RG_RETURN_IF_ERROR(fields.status());
  return ReadTaskBox(box, &limits->task);
}

}  // namespace

Status ValidateLimits(const SafetyLimits& limits, const std::vector<std::string>& joints,
                      const std::vector<double>& start) {
  const size_t n = joints.size();
  RG_RETURN_IF_ERROR(CheckSize("lower", limits.lower, n));
  RG_RETURN_IF_ERROR(CheckSize("upper", limits.upper, n));
  RG_RETURN_IF_ERROR(CheckSize("velocity", limits.velocity, n));
  RG_RETURN_IF_ERROR(CheckSize("torque", limits.torque, n));
  RG_RETURN_IF_ERROR(CheckSize("torque_rate", limits.torque_rate, n));
  if (!start.empty()) RG_RETURN_IF_ERROR(CheckSize("start pose", start, n));
  RG_RETURN_IF_ERROR(CheckPositionBox(limits, joints, start));
  RG_RETURN_IF_ERROR(CheckPositive("velocity", limits.velocity, joints));
  RG_RETURN_IF_ERROR(CheckPositive("torque", limits.torque, joints));
  RG_RETURN_IF_ERROR(CheckPositive("torque_rate", limits.torque_rate, joints));
  RG_RETURN_IF_ERROR(CheckTaskBox(limits.task));
  RG_RETURN_IF_ERROR(CheckAtLeast("torque_trip_ratio", limits.torque_trip_ratio, 1.0));
  RG_RETURN_IF_ERROR(CheckAtLeast("stale_s", limits.stale_s, 1e-3));
  RG_RETURN_IF_ERROR(CheckAtLeast("velocity_window_s", limits.velocity_window_s, 1e-3));
  RG_RETURN_IF_ERROR(CheckAtLeast("freeze_s", limits.freeze_s, 1e-3));
  RG_RETURN_IF_ERROR(CheckAtLeast("freeze_start_s", limits.freeze_start_s, limits.freeze_s));
  RG_RETURN_IF_ERROR(CheckAtLeast("jump_ratio", limits.jump_ratio, 1.0));
  RG_RETURN_IF_ERROR(CheckAtLeast("jump_tolerance", limits.jump_tolerance, 0.0));
  RG_RETURN_IF_ERROR(CheckAtLeast("max_consecutive_missed", limits.max_consecutive_missed, 1));
  RG_RETURN_IF_ERROR(CheckAtLeast("max_missed_share", limits.max_missed_share, 0.0));
  return CheckAtLeast("zero_torque_s", limits.zero_torque_s, 0.0);
}

Result<SafetyLimits> ParseLimits(const std::string& text, const std::string& source) {
  SafetyLimits limits;
  try {
    const Status status = ReadFields(json::parse(text), &limits);
    if (!status.ok()) return status.WithPrefix(source);
  } catch (const json::exception& error) {
    return InvalidError(source + ": " + error.what());
  }
  return limits;
}

std::string LimitsToJson(const SafetyLimits& limits) {
  json root{{"lower", limits.lower},
            {"upper", limits.upper},
            {"velocity", limits.velocity},
            {"torque", limits.torque},
            {"torque_rate", limits.torque_rate},
            {"torque_trip_ratio", limits.torque_trip_ratio},
            {"stale_s", limits.stale_s},
            {"velocity_window_s", limits.velocity_window_s},
            {"freeze_s", limits.freeze_s},
            {"freeze_start_s", limits.freeze_start_s},
            {"jump_ratio", limits.jump_ratio},
            {"jump_tolerance", limits.jump_tolerance},
            {"max_consecutive_missed", limits.max_consecutive_missed},
            {"max_missed_share", limits.max_missed_share},
            {"zero_torque_s", limits.zero_torque_s}};
  root["task_box"] = nullptr;
  if (limits.task.enabled) root["task_box"] = {{"lower", limits.task.lower}, {"upper", limits.task.upper}};
  return root.dump();
}

namespace {

Status CheckAsked(const char* field, const std::vector<double>& asked,
                  const std::vector<std::string>& joints) {
  if (asked.empty()) return Status::Ok();
  RG_RETURN_IF_ERROR(CheckSize(field, asked, joints.size()));
  for (size_t i = 0; i < joints.size(); ++i)
    if (std::isnan(asked[i]))
      return InvalidError(std::string("the job's ") + field + " limit of " + joints[i] + " is not a number");
  return Status::Ok();
}

void TakeSmaller(const std::vector<double>& asked, std::vector<double>* own) {
  for (size_t i = 0; i < asked.size(); ++i) (*own)[i] = std::min((*own)[i], asked[i]);
}

void TakeLarger(const std::vector<double>& asked, std::vector<double>* own) {
  for (size_t i = 0; i < asked.size(); ++i) (*own)[i] = std::max((*own)[i], asked[i]);
}

}  // namespace

Result<SafetyLimits> Tighten(const SafetyLimits& own, const TighterLimits& asked,
                             const std::vector<std::string>& joints) {
  RG_RETURN_IF_ERROR(CheckAsked("lower", asked.lower, joints));
  RG_RETURN_IF_ERROR(CheckAsked("upper", asked.upper, joints));
  RG_RETURN_IF_ERROR(CheckAsked("velocity", asked.velocity, joints));
  RG_RETURN_IF_ERROR(CheckAsked("torque", asked.torque, joints));
  SafetyLimits tighter = own;
  TakeLarger(asked.lower, &tighter.lower);
  TakeSmaller(asked.upper, &tighter.upper);
  TakeSmaller(asked.velocity, &tighter.velocity);
  TakeSmaller(asked.torque, &tighter.torque);
  RG_RETURN_IF_ERROR(ValidateLimits(tighter, joints, {}));
  return tighter;
}

}  // namespace rg::robot_agent
