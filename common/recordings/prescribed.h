// Joints that move as measured: another controller holds them, and no effort of theirs is known. Which they
// are (recording_set.h), and their velocities where no column gives them.
#pragma once

#include "common/base/status.h"
#include "common/recordings/recording.h"
#include "common/recordings/recording_set.h"

namespace rg::recordings {

// Makes the rows of v in `without_velocity` the slope of the positions; again after positions have changed.
void FillVelocities(Recording* recording);

// Fills set->prescribed from what the readers found in each recording. Where the manifest lists none, a joint
// is prescribed that has an effort in no recording while others have; one that has it in some of them is an
// error that names a file without.
Status ResolvePrescribed(RecordingSet* set);

// "lift_joint moves as measured (prescribed): it has no effort column, others have"; empty: there is none.
std::string NoteOnPrescribed(const RecordingSet& set);

}  // namespace rg::recordings
