// What is said of a recording set before any search, by `realitygrad check`, and first by `diagnose`, `sysid`
// and `submit diagnose`: the same warnings, the same refusals.
#pragma once

#include <map>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "services/diagnosis/data/motion_survey.h"
#include "services/diagnosis/reporting/what_shows.h"

namespace rg::diagnosis {

struct SetCheck {
  MotionSurvey survey;
  std::vector<std::string> warnings;  // one line each
  Status refusal;  // one line, where the data cannot be what they say they are; nothing is diagnosed then
};

// A second for 10 MB of CSV. kInvalid: recordings that nothing can be said of (none to fit, hardly a row).
Result<SetCheck> CheckSet(const recordings::RecordingSet& set, const sim::Plant& plant, bool trust_effort);

// Movable joints of the URDF that are not in the set, and where they stand [rad or m]; of a set that was
// read.
std::map<std::string, double> LockedJoints(const recordings::RecordingSet& set);

// "realitygrad.check/1", without its format. Lengths as in the set: SI units, rad or m, N m or N.
nlohmann::json CheckJson(const recordings::RecordingSet& set, const sim::Plant& plant, const SetCheck& check,
                         const std::vector<EffectShows>& effects);

}  // namespace rg::diagnosis
