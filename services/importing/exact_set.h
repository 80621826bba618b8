// A set as its files have it, value by value: to be written again elsewhere. LoadSet, for those who
// compute, unwraps angles and leaves velocities out that stand still.
#pragma once

#include <string>

#include "common/base/status.h"
#include "common/recordings/recording_set.h"

namespace rg::importing {

struct ExactSet {
  recordings::RecordingSet set;    // checked as LoadSet does; recordings as their files have them
  std::string manifest_json;       // the manifest's text, keys that nobody knows included
  std::vector<std::string> notes;  // columns of text, which a recording does not hold
};

// Every number of every column. A kind that is not there for every joint is in Recording::other.
Result<ExactSet> LoadExactSet(const std::string& folder);

// Writes the set and what its manifest said beyond the settings that this program knows: `manifest_json`'s
// other keys.
Status WriteExactSet(const std::string& folder, const recordings::RecordingSet& set,
                     const std::string& manifest_json);

// Moves columns "kind.joint" of Recording::other that are there for every joint into their matrices, and
// back where a value is missing.
void GatherKinds(recordings::Recording* recording);

}  // namespace rg::importing
