// What a reader should know of the data themselves, one line each: what is odd, where, and what helps.
#pragma once

#include <string>
#include <vector>

#include "common/effects/effect.h"
#include "services/diagnosis/data/motion_survey.h"
#include "services/diagnosis/hypotheses/search_result.h"

namespace rg::diagnosis {

// Known before any search: what the reader and the URDF's loader found odd; joints that never moved and what
// they hold against; positions, speeds and efforts beyond the URDF's limits; noise that is not as the
// manifest says; rows too far apart for an effect (which, says the catalogue) or for the motion; rows that
// are missing; commands that change between rows; velocities that lag; what was kept aside.
std::vector<std::string> NotesOn(const recordings::RecordingSet& set, const MotionSurvey& survey,
                                 const sim::Plant& plant);

// What the search found of a measured effort: that it lags the motion, what the findings leave of it.
std::vector<std::string> NotesOnMeasurement(const std::vector<std::string>& joint_names,
                                            const MeasuredEffort& measured);

// Of a mass on a rod among `effects` that predicts recordings kept aside no better than the given model does
// (RMS of their windows before and after): why that says nothing against it. Empty otherwise.
std::string NoteOnFreeSwing(const std::vector<effects::EffectSpec>& effects, double before_rms,
                            double after_rms);

}  // namespace rg::diagnosis
