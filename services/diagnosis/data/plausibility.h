// Before any solving: whether the data can be what they say they are (step 1 of the diagnosis).
#pragma once

#include <string>
#include <vector>

#include "services/diagnosis/data/motion_survey.h"

namespace rg::diagnosis {

// How the effort in the file goes with the torque that the URDF needs for the recorded motion, per joint:
// effort = slope · RNEA + viscous · v + dry · sign(v) + constant.
struct EffortMatch {
  double slope = 1;
  double share = 0;  // of what the other terms leave, that RNEA explains
};
std::vector<EffortMatch> MatchEfforts(const MotionSurvey& survey);

// Refuses recordings in which nothing moves, and, unless `trust_effort`, efforts that follow the model
// closely with the wrong sign or some other unit, or that leave gravity to the drive where the manifest does
// not say so (gravity_in_effort.h): one line that names joint, finding, a guess and a remedy. With
// `trust_effort`, or where the manifest itself says that the effort is all there is, that line is appended to
// `notes` instead.
Status CheckPlausible(const recordings::RecordingSet& set, const MotionSurvey& survey,
                      const sim::Plant& plant, bool trust_effort, std::vector<std::string>* notes);

}  // namespace rg::diagnosis
