// Before any solving: whether the data can be what they say they are (step 1 of the diagnosis).
#pragma once

#include <string>
#include <vector>

#include "services/diagnosis/features.h"
#include "services/diagnosis/search.h"

namespace rg::diagnosis {

// How the effort in the file goes with the torque that the URDF needs for the recorded motion, per joint:
// effort = slope · RNEA + viscous · v + dry · sign(v) + constant.
struct EffortMatch {
  double slope = 1;
  double share = 0;  // of what the other terms leave, that RNEA explains
};
std::vector<EffortMatch> MatchEfforts(const FitData& data, const sim::Plant& plant);

// Refuses recordings in which nothing moves, and, unless `trust_effort`, efforts that follow the model
// closely with the wrong sign or some other unit: one line that names joint, finding and a guess. With
// `trust_effort` that line is appended to `notes` instead.
Status CheckPlausible(const recordings::RecordingSet& set, const FitData& data, const sim::Plant& plant,
                      const MotionScales& scales, bool trust_effort, std::vector<std::string>* notes);

// What else a reader should know: velocities that lag their positions, efforts that lag the motion, what the
// findings leave of a measured effort.
std::vector<std::string> NotesOnMeasurement(const recordings::RecordingSet& set, const FitData& data,
                                            const sim::Plant& plant, const MeasuredEffort& measured);

}  // namespace rg::diagnosis
