#include "services/diagnosis/reporting/experiments.h"

#include <algorithm>
#include <utility>

#include "common/effects/inference.h"
#include "services/diagnosis/data/words.h"

namespace rg::diagnosis {
namespace {

using effects::Probe;

// The words before and after the names of the joints.
std::pair<std::string, std::string> WordsOf(Probe probe) {
  switch (probe) {
    case Probe::kSlowRamps:
      return {"slow ramps of ", " at 0.01 to 0.05 rad/s through several reversals"};
    case Probe::kChirp:
      return {"a chirp of ",
              " up to half the sample rate: phase grows with frequency for a delay, saturates for a lag"};
    case Probe::kLoads:
      return {"the same slow motion of ", " with and without load, arm stretched and folded"};
    case Probe::kSpeeds:
      return {"constant speeds of ", " at five levels in both directions"};
    case Probe::kRepeats:
      return {"the same motion of ", " repeated for several minutes"};
    case Probe::kReversals:
      return {"fast reversals and slow holds of ", " in several poses"};
    case Probe::kVibration:
      return {"a chirp of ", " through 2 to 20 Hz at high sample rate"};
    case Probe::kSweep:
      break;
  }
  return {"a slow sweep of ", " through the whole range in both directions"};
}

// Masses show in fast reversals.
Probe ProbeOf(const std::string& id) {
  return id == "parameters_only" ? Probe::kReversals : effects::InferenceOf(id).probe;
}

}  // namespace

std::string ExperimentFor(const std::string& a, const std::string& b,
                          const std::vector<std::string>& joints) {
  const auto [before, after] = WordsOf(std::min(ProbeOf(a), ProbeOf(b)));
  return before + (joints.empty() ? "the joints" : Listed(joints)) + after;
}

}  // namespace rg::diagnosis
