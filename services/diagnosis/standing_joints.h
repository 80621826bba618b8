// Joints that stood still in all recordings. What acts on them nobody can tell, so that nothing is looked for
// there: they are prescribed while a set is diagnosed, and what they are to be once it is. A note says what
// they held against (data_notes.h).
#pragma once

#include <vector>

#include "common/recordings/recording_set.h"
#include "common/sim/plant.h"

namespace rg::diagnosis {

// Joints that moved by less than kMovesBy of their sensor's noise over all recordings, fitted or not,
// ascending. None that is prescribed, or has effects in the model it is given; none at all where no other
// joint is left.
std::vector<int> StandingJoints(const recordings::RecordingSet& set, const sim::Plant& given);

// The set and the plant in which these joints are prescribed too.
recordings::RecordingSet WithStanding(recordings::RecordingSet set, const std::vector<int>& joints);
sim::Plant WithStanding(const sim::Plant& given, const std::vector<int>& joints);

// `found`, of the same robot, with the roles that the joints have in `given`.
sim::Plant WithRolesOf(const sim::Plant& found, const sim::Plant& given);

}  // namespace rg::diagnosis
