#include "services/diagnosis/experiments.h"

#include <algorithm>

#include "services/diagnosis/words.h"

namespace rg::diagnosis {
namespace {

struct Experiment {
  std::vector<std::string> effects;  // either of which it tells from others
  std::string before, after;         // the joints' names
};

// The first that tells one of two is proposed: what shows the rarer law best comes first.
const std::vector<Experiment>& Experiments() {
  static const std::vector<Experiment> experiments = {
      {{"stribeck_friction", "presliding_hysteresis", "backlash"},
       "slow ramps of ",
       " at 0.01 to 0.05 rad/s through several reversals"},
      {{"actuator_delay", "actuator_lag", "sensor_delay"},
       "a chirp of ",
       " up to half the sample rate: phase grows with frequency for a delay, saturates for a lag"},
      {{"load_dependent_friction"},
       "the same slow motion of ",
       " with and without load, arm stretched and folded"},
      {{"viscous_friction", "quadratic_drag", "coulomb_friction", "asymmetric_friction"},
       "constant speeds of ",
       " at five levels in both directions"},
      {{"thermal_drift"}, "the same motion of ", " repeated for several minutes"},
      {{"payload", "parameters_only", "torque_gain", "rotor_inertia"},
       "fast reversals and slow holds of ",
       " in several poses"},
      {{"joint_elasticity", "base_flexibility"}, "a chirp of ", " through 2 to 20 Hz at high sample rate"},
      {{}, "a slow sweep of ", " through the whole range in both directions"}};
  return experiments;
}

}  // namespace

std::string ExperimentFor(const std::string& a, const std::string& b,
                          const std::vector<std::string>& joints) {
  const auto& all = Experiments();
  const auto chosen = std::find_if(all.begin(), all.end() - 1, [&](const Experiment& e) {
    return std::any_of(e.effects.begin(), e.effects.end(),
                       [&](const std::string& id) { return id == a || id == b; });
  });
  return chosen->before + (joints.empty() ? "the joints" : Listed(joints)) + chosen->after;
}

}  // namespace rg::diagnosis
