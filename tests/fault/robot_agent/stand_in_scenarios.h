// Seeded rollouts of the stand-in with one fault each, in a time of their own: what the arm saw, what was recorded.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "tests/support/robot_agent/stand_in_link.h"

namespace rg::robot_agent {

enum class Trouble {
  kNone,
  kOutage,           // the arm's interface is gone for 1.3 s, some time in torque mode
  kOutages,          // the same at random in any mode
  kFallBack,         // the base leaves torque mode by itself
  kWrongSign,        // of one joint's torques
  kDeadJoint,        // one joint ignores its torques
  kFrozen,           // positions stay while stamps advance
  kHangingServices,  // after some time in torque mode nothing is answered
  kDeafToStops,      // position mode is asked for in vain, up to four times
  kControllerNan,
  kControllerWild,  // five times the torque limit
  kOperatorStop,
  kKilled,  // the agent's process, kill -9, at any moment
  kCount,
};
const char* TroubleName(Trouble fault);

struct Scenario {
  uint64_t seed = 0;
  Trouble fault = Trouble::kNone;
  stand_in::StandInConfig config;
  stand_in::LinkFaults link;
  double at_s = 0.0;  // kill: after the start; others: after the first command
};
Scenario DrawScenario(uint64_t seed);

// What a scenario came to; `wrong` holds every broken promise in words.
struct Verdict {
  int begun = 0, completed = 0, refused = 0, salvaged = 0, latched = 0, recordings = 0;
  int moved_twice = 0, lost = 0;
  std::string reason;  // of the first rollout's end
  std::vector<std::string> wrong;
};
// In processes of its own, below `folder`, which is removed.
Verdict RunScenario(const Scenario& scenario, const std::string& folder);

}  // namespace rg::robot_agent
