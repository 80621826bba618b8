// Notes on the data, one line each: what is unusual, where, and the remedy.
#pragma once

#include <string>
#include <vector>

#include "common/effects/effect.h"
#include "services/diagnosis/data/motion_survey.h"
#include "services/diagnosis/hypotheses/search_result.h"

namespace rg::diagnosis {

// Before any search: warnings of reader and URDF loader; joints that never moved, and the torque that they
// withstood; positions, speeds and efforts beyond the URDF's limits; noise other than in the manifest; a
// sample rate too low for effects (by the catalogue) or for the motion; missing rows; commands that change
// between rows; velocities that lag; held-out recordings.
std::vector<std::string> NotesOn(const recordings::RecordingSet& set, const MotionSurvey& survey,
                                 const sim::Plant& plant);

// After a search over a measured effort: efforts that lag the motion; what the findings leave of the effort.
std::vector<std::string> NotesOnMeasurement(const std::vector<std::string>& joint_names,
                                            const MeasuredEffort& measured);

}  // namespace rg::diagnosis
