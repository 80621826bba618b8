// What a reader should know of the data themselves, one line each.
#pragma once

#include <string>
#include <vector>

#include "services/diagnosis/features.h"

namespace rg::diagnosis {

// Joints that never moved; positions beyond the URDF's limits; rows too far apart for an effect (which) or
// for the motion; rows that are missing; commands that change between rows; what the manifest says otherwise.
std::vector<std::string> NotesOn(const recordings::RecordingSet& set, const FitData& data,
                                 const sim::Plant& nominal, const MotionScales& scales);

// Of a mass on a rod among `effects` that predicts recordings kept aside no better than the given model does
// (RMS of their windows before and after): why that says nothing against it. Empty otherwise.
std::string NoteOnFreeSwing(const std::vector<effects::EffectSpec>& effects, double before_rms,
                            double after_rms);

// A joint that moved by no more than its sensor's noise.
struct StillJoint {
  int joint = 0;
  double missed = 0, needed = 0;  // RMS: effort less the torque that the URDF needs there, and that torque
  bool held = false;              // by something else than its effort
};
std::vector<StillJoint> StillJoints(const FitData& data, const sim::Plant& nominal,
                                    const MotionScales& scales);

}  // namespace rg::diagnosis
