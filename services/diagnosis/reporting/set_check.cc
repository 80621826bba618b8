#include "services/diagnosis/reporting/set_check.h"

#include <algorithm>

#include "common/model/urdf_document.h"
#include "services/diagnosis/data/plausibility.h"
#include "services/diagnosis/reporting/data_notes.h"

namespace rg::diagnosis {

Result<SetCheck> CheckSet(const recordings::RecordingSet& set, const sim::Plant& plant, bool trust_effort) {
  SetCheck check;
  RG_ASSIGN_OR_RETURN(check.survey, Survey(set, plant));
  check.warnings = NotesOn(set, check.survey, plant);
  check.refusal = CheckPlausible(set, check.survey, plant, trust_effort, &check.warnings);
  return check;
}

std::map<std::string, double> LockedJoints(const recordings::RecordingSet& set) {
  std::map<std::string, double> out;
  const auto document = model::ReadUrdfDocument(set.urdf_text, set.urdf_path);
  if (!document.ok()) return set.locked;
  for (const model::UrdfJoint& joint : document->joints) {
    if (joint.is_fixed || joint.mimic) continue;
    if (std::ranges::find(set.joints, joint.name) != set.joints.end()) continue;
    const auto at = set.locked.find(joint.name);
    out[joint.name] = at == set.locked.end() ? 0.0 : at->second;
  }
  return out;
}

}  // namespace rg::diagnosis
