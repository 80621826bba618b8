// Plausibility of the data before any search: do efforts and motion agree with URDF and manifest?
#pragma once

#include <string>
#include <vector>

#include "services/diagnosis/data/motion_survey.h"

namespace rg::diagnosis {

// Regression of the effort in the file on the torque that the URDF needs for the recorded motion, per joint:
// effort = slope · RNEA + viscous · v + dry · sign(v) + constant.
struct EffortMatch {
  double slope = 1;
  double share = 0;  // of what the other terms leave, that RNEA explains
};
std::vector<EffortMatch> MatchEfforts(const MotionSurvey& survey);

// Refuses recordings without motion, and, unless `trust_effort`, efforts that follow the model closely with
// the wrong sign or unit, or without gravity where the manifest does not declare that (gravity_in_effort.h):
// one line with joint, finding, a guess and a remedy. With `trust_effort`, or where the manifest declares the
// effort complete, that line is appended to `notes` instead.
Status CheckPlausible(const recordings::RecordingSet& set, const MotionSurvey& survey,
                      const sim::Plant& plant, bool trust_effort, std::vector<std::string>* notes);

}  // namespace rg::diagnosis
