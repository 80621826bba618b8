// Check of a recording set before any search: the same warnings and refusals for `realitygrad check`,
// `diagnose`, `sysid` and `submit diagnose`.
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
  Status refusal;  // one line, where the data contradict their manifest; then nothing is diagnosed
};

// About 1 s for 10 MB of CSV. kInvalid: no recording to fit, or too few rows.
Result<SetCheck> CheckSet(const recordings::RecordingSet& set, const sim::Plant& plant, bool trust_effort);

// Movable joints of the URDF that are not in the set, and where they stand [rad or m]; of a set that was
// read.
std::map<std::string, double> LockedJoints(const recordings::RecordingSet& set);

// "realitygrad.check/1", without its format. Lengths as in the set: SI units, rad or m, N m or N.
nlohmann::json CheckJson(const recordings::RecordingSet& set, const sim::Plant& plant, const SetCheck& check,
                         const std::vector<EffectShows>& effects);

}  // namespace rg::diagnosis
