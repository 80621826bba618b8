#include "services/rollouts/rollout_end.h"

#include <nlohmann/json.hpp>

#include "common/base/printf.h"

namespace rg::rollouts {
namespace {

using nlohmann::json;

std::string Text(const json& rollout, const char* key) {
  const auto found = rollout.find(key);
  return found != rollout.end() && found->is_string() ? found->get<std::string>() : "";
}

// " after 1.44 of 6 s"; what is not said is left out.
std::string After(const json& rollout) {
  const auto number = [&](const char* key) {
    const auto found = rollout.find(key);
    return found != rollout.end() && found->is_number() ? found->get<double>() : -1.0;
  };
  const double ended = number("ended_after_s"), asked = number("duration_s");
  const std::string of = asked >= 0 ? Printf(" of %.3g", asked) : "";
  return ended >= 0 ? Printf(" after %.3g%s s", ended, of.c_str()) : "";
}

}  // namespace

RolloutEnd HowItEnded(const json& rollout) {
  const std::string reason = rollout.is_object() ? Text(rollout, "end_reason") : "";
  if (reason.empty()) return {};
  const auto held = rollout.find("held");
  const bool at_rest = held == rollout.end() || !held->is_boolean() || held->get<bool>();
  const std::string unseen = at_rest ? "" : "; the arm was not seen at rest";
  if (reason == "completed") return {at_rest, "complete" + unseen};
  const std::string detail = Text(rollout, "detail");
  return {false,
          "stopped by " + reason + (detail.empty() ? "" : " (" + detail + ")") + After(rollout) + unseen};
}

RolloutEnd HowItEnded(const std::string& rollout_json) {
  return HowItEnded(json::parse(rollout_json, nullptr, false));
}

}  // namespace rg::rollouts
