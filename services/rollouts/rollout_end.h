// How a rollout ended, in words, from what its recording says of it.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

namespace rg::rollouts {

struct RolloutEnd {
  bool as_asked = true;  // it came to its end, or nobody says how it ended
  // "complete", "stopped by velocity_limit (elbow: velocity 2.1 beyond its limit 2) after 1.44 of 6 s"; empty:
  // nobody says.
  std::string text;
};

// `rollout`: rollout.json, or the metadata of a recording's artefact.
RolloutEnd HowItEnded(const nlohmann::json& rollout);
RolloutEnd HowItEnded(const std::string& rollout_json);

}  // namespace rg::rollouts
