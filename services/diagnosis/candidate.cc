#include "services/diagnosis/candidate.h"

#include <algorithm>
#include <set>

#include "common/effects/effect_catalog.h"

namespace rg::diagnosis {

using effects::EffectSpec;

namespace {

constexpr double kBasePrior = 1.0;   // −log odds of a URDF that is off
constexpr double kJointPrior = 1.0;  // of one more joint of it
constexpr double kShapePrior =
    1.0;  // of each parameter beyond the first: what the data do not show costs too
// A drive's command waits for its bus and cycle more often than a sensor's reading does; where both are on
// all joints nothing but the first moments of a recording tells them apart.
constexpr double kSensorDelayPrior = 2.0;
constexpr double kFieldPrior = 6.0;  // what an unnamed force pays beside

}  // namespace

double StructurePrior(const std::vector<EffectSpec>& specs, bool base) {
  std::set<std::string> ids;
  double cost = base ? kBasePrior : 0.0;
  for (const EffectSpec& s : specs) {
    ids.insert(s.id);
    cost +=
        kJointPrior + kShapePrior * (static_cast<double>(effects::FindEffect(s.id)->parameters.size()) - 1.0);
    if (s.id == "sensor_delay") cost += kSensorDelayPrior;
    if (s.id == "unknown_field" || s.id == "unknown_field_pair") cost += kFieldPrior;
  }
  return cost + kEffectPrior * static_cast<double>(ids.size());
}

bool Contains(const std::vector<EffectSpec>& specs, const std::string& id, const std::string& joint) {
  for (const EffectSpec& s : specs) {
    if (s.id != id) continue;
    if (s.joints.empty() || joint.empty() || id == "joint_coupling") {
      if (s.joints.empty()) return true;
      continue;
    }
    if (std::find(s.joints.begin(), s.joints.end(), joint) != s.joints.end()) return true;
  }
  return false;
}

}  // namespace rg::diagnosis
