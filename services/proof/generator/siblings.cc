#include "services/proof/generator/siblings.h"

#include <algorithm>
#include <initializer_list>

namespace rg::proof {
namespace {

void OneLevel(double level, JointTruth* j) {
  j->dry = DryFriction{};
  j->dry.coulomb_positive = j->dry.coulomb_negative = level;
  j->bristle = Bristle{};
}

void Rigid(JointTruth* j) {
  j->armature += j->transmission.motor_inertia;
  j->transmission = Transmission{};
}

// Between the level without what makes the effect special (0) and that with all of it (1).
double Level(const std::string& effect, const JointTruth& j, double load, double part) {
  const DryFriction& f = j.dry;
  if (effect == "stribeck_friction") return f.coulomb_positive + part * f.static_extra;
  if (effect == "asymmetric_friction")
    return f.coulomb_negative + part * (f.coulomb_positive - f.coulomb_negative);
  if (effect == "load_dependent_friction") return f.coulomb_positive + 1.5 * part * f.load_coefficient * load;
  if (effect == "thermal_drift") return f.coulomb_positive + part * f.thermal_extra;
  return j.bristle.coulomb * (0.5 + part);  // presliding_hysteresis
}

std::vector<Truth> OfFriction(const Truth& truth, const std::string& effect, size_t joint, double load) {
  std::vector<Truth> out;
  for (const double part : {0.0, 0.25, 0.5, 0.75}) {
    out.push_back(truth);
    OneLevel(Level(effect, truth.joint[joint], load, part), &out.back().joint[joint]);
  }
  return out;
}

Truth Held(const Truth& truth, const std::array<double, 3>& tool) {
  Truth out = truth;
  const double mass = truth.payload_mass + truth.slosh_mass;
  for (int k = 0; k < 3; ++k)
    out.payload_com[k] =
        (truth.payload_mass * truth.payload_com[k] + truth.slosh_mass * tool[static_cast<size_t>(k)]) / mass;
  out.payload_mass = mass;
  out.slosh_mass = out.slosh_length = 0;
  return out;
}

}  // namespace

std::vector<Truth> SimplerSiblings(const Truth& truth, const std::string& effect, size_t joint, double load,
                                   const std::array<double, 3>& tool) {
  if (effect == "joint_elasticity" || effect == "backlash") {
    std::vector<Truth> out = {truth};
    Rigid(&out[0].joint[joint]);
    if (effect == "backlash") {
      out.push_back(truth);
      out[1].joint[joint].transmission.gap = 0;
    }
    return out;
  }
  if (effect == "sloshing_payload") return {Held(truth, tool)};
  if (effect == "coulomb_friction") {
    std::vector<Truth> out = {truth};
    OneLevel(1.5 * truth.joint[joint].dry.coulomb_positive, &out[0].joint[joint]);
    return out;
  }
  const bool friction = OneOf(effect, {"stribeck_friction", "asymmetric_friction", "load_dependent_friction",
                                       "thermal_drift", "presliding_hysteresis"});
  return friction ? OfFriction(truth, effect, joint, load) : std::vector<Truth>{};
}

}  // namespace rg::proof
