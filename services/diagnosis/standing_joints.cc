#include "services/diagnosis/standing_joints.h"

#include <algorithm>
#include <limits>
#include <string>

#include "common/base/check.h"
#include "common/recordings/noise.h"
#include "services/diagnosis/motion.h"
#include "services/diagnosis/motion_survey.h"

namespace rg::diagnosis {
namespace {

// The largest less the smallest position of all recordings.
double Travel(const recordings::RecordingSet& set, int joint) {
  double low = std::numeric_limits<double>::infinity(), high = -low;
  for (const recordings::Recording& r : set.recordings)
    low = std::min(low, r.q.row(joint).minCoeff()), high = std::max(high, r.q.row(joint).maxCoeff());
  return high - low;
}

bool HasEffects(const sim::Plant& plant, const std::string& joint) {
  return std::ranges::any_of(plant.effects(), [&](const effects::EffectSpec& e) {
    return std::ranges::find(e.joints, joint) != e.joints.end();
  });
}

sim::Plant Must(Result<sim::Plant> plant) {
  RG_CHECK(plant.ok()) << plant.status().ToString();
  return std::move(plant).value();
}

}  // namespace

std::vector<int> StandingJoints(const recordings::RecordingSet& set, const sim::Plant& given) {
  const auto noise = WorkingNoise(recordings::EstimateSensorNoise(set), set.noise);
  std::vector<int> out;
  for (int j = 0; j < given.num_joints(); ++j) {
    const bool stands = Travel(set, j) < kMovesBy * noise.position_stddev[j];
    if (stands && !given.IsPrescribed(j) && !HasEffects(given, given.joint_names()[static_cast<size_t>(j)]))
      out.push_back(j);
  }
  if (out.size() + given.prescribed().size() >= static_cast<size_t>(given.num_joints())) out.clear();
  return out;
}

recordings::RecordingSet WithStanding(recordings::RecordingSet set, const std::vector<int>& joints) {
  for (const int j : joints) set.prescribed.push_back(set.joints[static_cast<size_t>(j)]);
  for (recordings::Recording& r : set.recordings) {
    for (const int j : joints) {
      r.prescribed.push_back(j);
      for (Eigen::MatrixXd* effort : {&r.effort_command, &r.effort_measured}) {
        if (effort->size() > 0) effort->row(j).setZero();
      }
    }
    std::sort(r.prescribed.begin(), r.prescribed.end());
  }
  return set;
}

sim::Plant WithStanding(const sim::Plant& given, const std::vector<int>& joints) {
  std::vector<std::string> prescribed = given.options().prescribed, passive = given.options().passive;
  for (const int j : joints) {
    const std::string& joint = given.joint_names()[static_cast<size_t>(j)];
    prescribed.push_back(joint);
    std::erase(passive, joint);
  }
  return Must(given.WithRoles(prescribed, passive));
}

sim::Plant WithRolesOf(const sim::Plant& found, const sim::Plant& given) {
  return Must(found.WithRoles(given.options().prescribed, given.options().passive));
}

}  // namespace rg::diagnosis
