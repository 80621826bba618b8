#include "common/recordings/prescribed.h"

#include <algorithm>

#include "common/recordings/noise.h"

namespace rg::recordings {

void FillVelocities(Recording* r) {
  if (r->without_velocity.empty() || !r->has_velocity()) return;
  Recording alone;
  alone.t = r->t;
  alone.q.resize(1, r->rows());
  for (const int i : r->without_velocity) {
    alone.q = r->q.row(i);
    r->v.row(i) = SmoothVelocity(alone);
  }
}

Status ResolvePrescribed(RecordingSet* set) {
  set->prescribed.clear();
  for (size_t j = 0; j < set->joints.size(); ++j) {
    const std::string& joint = set->joints[j];
    const auto is = [&](const Recording& r) { return r.IsPrescribed(static_cast<int>(j)); };
    const auto without = std::find_if(set->recordings.begin(), set->recordings.end(), is);
    if (without == set->recordings.end()) continue;
    if (!std::all_of(set->recordings.begin(), set->recordings.end(), is)) {
      return InvalidError(set->folder + "/" + without->name + ": header (line 1): no effort of " + joint +
                          ", which other recordings have (\"prescribed\" in the manifest: it moves as "
                          "measured)");
    }
    set->prescribed.push_back(joint);
  }
  return Status::Ok();
}

std::string NoteOnPrescribed(const RecordingSet& set) {
  if (set.prescribed.empty()) return "";
  std::string names;
  for (const std::string& joint : set.prescribed) names += (names.empty() ? "" : ", ") + joint;
  const bool one = set.prescribed.size() == 1;
  return names + (one ? " moves" : " move") + " as measured (prescribed): " +
         (set.prescribed_listed ? "the manifest says so"
          : one                 ? "it has no effort column, others have"
                                : "they have no effort columns, others have") +
         "; nothing is said of " + (one ? "it" : "them");
}

}  // namespace rg::recordings
