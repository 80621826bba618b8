#include "services/proof/generator/ordinary.h"

#include <algorithm>
#include <cmath>

#include "services/proof/generator/robots.h"
#include "services/proof/generator/siblings.h"

namespace rg::proof {
namespace {

using nlohmann::json;

// Of the strongest joint's torque and inertia, what a gear of the lightest joint has as well.
constexpr double kLeastTorque = 0.2, kLeastInertia = 0.08;
constexpr double kSpringyRate = 100;  // Hz
constexpr double kLinkOverMotor = 0.7;
constexpr double kShortest = 4e-3;        // s, time constant of a link's inertia and its damping alone
constexpr double kReferenceSpeed = 0.15;  // rad/s or m/s, that damping is never stated at less than

double LogUniform(double low, double high, Rng& rng) { return low * std::pow(high / low, rng.Uniform()); }

bool Springy(const std::string& id) { return OneOf(id, {"joint_elasticity", "backlash"}); }

// x, at least `least` of the largest among joints of the same kind.
double Floored(const Eigen::VectorXd& x, Eigen::Index i, double least, const std::vector<bool>& prismatic) {
  double largest = 0;
  for (Eigen::Index k = 0; k < x.size(); ++k) {
    if (prismatic[static_cast<size_t>(k)] == prismatic[static_cast<size_t>(i)])
      largest = std::max(largest, x[k]);
  }
  return std::max(x[i], least * largest);
}

void SetDry(const std::string& friction, double level, double speed, Rng& rng, DryFriction* dry) {
  dry->coulomb_positive = dry->coulomb_negative = level;
  if (friction == "stribeck_friction") {
    dry->static_extra = level * rng.Uniform(0.4, 0.9);
    dry->stribeck_velocity = speed * rng.Uniform(0.25, 0.6);
  } else if (friction == "asymmetric_friction") {
    const double more = rng.Uniform(1.15, 1.5), less = rng.Uniform(0.5, 0.8);
    const bool forward = rng.Uniform() < 0.5;
    dry->coulomb_positive *= forward ? more : less;
    dry->coulomb_negative *= forward ? less : more;
  }
}

json Entry(const std::string& id) {
  return {{"id", id},
          {"joints", json::array()},
          {"localisation", "joints"},
          {"parameters", json::object()},
          {"also_acceptable", json::array()},
          {"equivalents", json::array()}};
}

// Parameters of effect `id` on one joint; null where it has none of it.
json Row(const std::string& id, const JointTruth& j, bool prismatic) {
  const auto value = [&](double x, const char* unit) { return UnitValue(x, unit, prismatic); };
  const bool loaded = j.dry.load_coefficient > 0;
  if (id == "coulomb_friction" && !loaded && j.dry.any())
    return {{"coulomb", value(j.dry.coulomb_positive, "N*m")}};
  if (id == "stribeck_friction")
    return {{"coulomb", value(j.dry.coulomb_positive, "N*m")},
            {"static", value(j.dry.coulomb_positive + j.dry.static_extra, "N*m")},
            {"stribeck_velocity", value(j.dry.stribeck_velocity, "rad/s")}};
  if (id == "asymmetric_friction")
    return {{"coulomb_positive", value(j.dry.coulomb_positive, "N*m")},
            {"coulomb_negative", value(j.dry.coulomb_negative, "N*m")}};
  if (id == "viscous_friction") return {{"viscous", value(j.viscous, "N*m*s/rad")}};
  if (id == "rotor_inertia" && j.armature > 0) return {{"armature", value(j.armature, "kg*m^2")}};
  if (id == "actuator_lag") return {{"time_constant", value(j.lag, "s")}};
  if (id == "actuator_delay") return {{"delay", value(j.delay, "s")}};
  return nullptr;
}

// Joints that a right answer may name or leave out.
void AddOptionalJoints(const Scales& scales, const Truth& truth, json* entry) {
  const std::string id = (*entry)["id"];
  std::vector<std::string> optional;
  for (size_t i = 0; i < scales.joints.size(); ++i) {
    const JointTruth& j = truth.joint[i];
    // About its own axis the first link's inertia is the same as its rotor's.
    const bool same_as_link = i == 0 && j.armature > 0 && !scales.prismatic[0];
    if (id == "rotor_inertia" && same_as_link) (*entry)["also_acceptable"].push_back("parameters_only");
    if ((id == "rotor_inertia" && (same_as_link || j.transmission.stiffness > 0)) ||
        (id == "coulomb_friction" && j.dry.load_coefficient > 0))
      optional.push_back(scales.joints[i]);
  }
  if (!optional.empty()) (*entry)["optional_joints"] = optional;
}

json LoadDependent(const Scales& scales, Rng& rng, Truth* truth, double strength) {
  std::vector<size_t> loaded;  // joints whose drives carry something
  for (size_t i = 0; i < scales.joints.size(); ++i) {
    const auto at = static_cast<Eigen::Index>(i);
    if (scales.torque[at] > 0.3 * scales.torque.maxCoeff()) loaded.push_back(i);
  }
  const size_t i = loaded[rng.Index(loaded.size())];
  DryFriction& dry = truth->joint[i].dry;
  dry.load_coefficient = std::min(0.4, strength * rng.Uniform(0.06, 0.2));
  json entry = Entry("load_dependent_friction");
  entry["joints"].push_back(scales.joints[i]);
  entry["parameters"][scales.joints[i]] = {
      {"coulomb", UnitValue(dry.coulomb_positive, "N*m", scales.prismatic[i])},
      {"load_coefficient", UnitValue(dry.load_coefficient, "1", scales.prismatic[i])}};
  entry["also_acceptable"].push_back("coulomb_friction");
  return entry;
}

size_t IndexOf(const Scales& scales, const std::string& joint) {
  return static_cast<size_t>(std::find(scales.joints.begin(), scales.joints.end(), joint) -
                             scales.joints.begin());
}

// The motor behind the spring is the rotor that the joint had.
bool TakeRotor(const Scales& scales, json* entry, Truth* truth) {
  const std::string joint = (*entry)["joints"][0];
  const size_t i = IndexOf(scales, joint);
  JointTruth& j = truth->joint[i];
  if (scales.inertia[static_cast<Eigen::Index>(i)] < kLinkOverMotor * j.armature) return false;
  j.transmission.motor_inertia = j.armature;
  j.armature = 0;
  (*entry)["parameters"][joint]["motor_inertia"] =
      UnitValue(j.transmission.motor_inertia, "kg*m^2", scales.prismatic[i]);
  return true;
}

std::string DrawTiming(Rng& rng) {
  const double late = rng.Uniform();
  return late < 0.35 ? "actuator_lag" : late < 0.55 ? "actuator_delay" : "";
}

// The joint as somebody would have it who knows of no gain: all that its drive moves alone is larger.
void ScaleOwn(double factor, JointTruth* j) {
  DryFriction& f = j->dry;
  for (double* x : {&f.coulomb_positive, &f.coulomb_negative, &f.static_extra, &j->viscous, &j->armature})
    *x *= factor;
}

}  // namespace

const std::vector<std::string>& OrdinaryRobots() {
  static const std::vector<std::string> kinds = {"mico2", "arm6", "mico2", "arm6", "arm7",     "arm4",
                                                 "scara", "arm2", "arm2",  "arm2", "pendulum", "slide"};
  return kinds;
}

const std::vector<double>& OrdinaryRates() {
  static const std::vector<double> rates = {25, 50, 100, 200, 500};
  return rates;
}

std::vector<std::string> OrdinaryExtras(const std::string& kind, double rate_hz, const Ordinary& ordinary) {
  std::vector<std::string> extras = {"torque_ripple"};
  if (!ordinary.wrong_bodies) extras.push_back("position_spring");
  if (rate_hz >= kSpringyRate) extras.insert(extras.end(), {"joint_elasticity", "backlash"});
  if (ordinary.friction == "coulomb_friction") extras.push_back("load_dependent_friction");
  if (kind == "pendulum" || kind == "slide") return extras;
  extras.push_back("payload");
  if (ordinary.wrong_bodies) return extras;
  if (ordinary.friction != "asymmetric_friction") extras.push_back("torque_offset");
  extras.insert(extras.end(), {"joint_coupling", "gravity_misalignment", "torque_gain", "encoder_offset"});
  return extras;
}

Ordinary DrawDeclared(Rng rng) {
  Ordinary out;
  out.rotors = rng.Uniform() < 2.0 / 3.0;
  if (out.rotors) out.timing = DrawTiming(rng);
  return out;
}

Ordinary DrawOrdinary(const std::string& kind, double rate_hz, Rng rng) {
  Ordinary out;
  out.timing = DrawTiming(rng);
  const double dice = rng.Uniform();
  if (dice < 0.15) out.friction = "stribeck_friction";
  if (dice > 0.88) out.friction = "asymmetric_friction";
  out.wrong_bodies = rng.Uniform() < 0.2;
  const std::vector<std::string> extras = OrdinaryExtras(kind, rate_hz, out);
  if (rng.Uniform() < 2.0 / 3.0) out.extra = extras[rng.Index(extras.size())];
  return out;
}

void SetGears(const Ordinary& ordinary, const Scales& scales, double rate_hz, Rng rng, Truth* truth) {
  const double dry = LogUniform(0.25, 0.7, rng), damped = LogUniform(0.25, 0.8, rng),
               rotor = LogUniform(0.25, 0.8, rng);
  const double late = LogUniform(rate_hz < 100 ? 0.015 : 0.006, 0.03, rng);
  Eigen::VectorXd torque = 0.3 * scales.torque + 0.7 * scales.motion_torque;
  for (Eigen::Index i = 0; i < torque.size(); ++i) {
    JointTruth& j = truth->joint[static_cast<size_t>(i)];
    const double gear = Floored(torque, i, kLeastTorque, scales.prismatic),
                 speed = std::max(kReferenceSpeed, scales.velocity[i]);
    SetDry(ordinary.friction, dry * LogUniform(0.7, 1.4, rng) * gear, scales.velocity[i], rng, &j.dry);
    j.viscous = damped * LogUniform(0.7, 1.4, rng) * gear / speed;
    const double inertia = Floored(scales.inertia, i, kLeastInertia, scales.prismatic);
    // A light link that no rotor steadies would be damped faster than the engine steps.
    if (!ordinary.rotors) j.viscous = std::min(j.viscous, scales.inertia[i] / kShortest);
    if (ordinary.rotors) j.armature = rotor * LogUniform(0.7, 1.4, rng) * inertia;
    if (ordinary.timing == "actuator_lag") j.lag = late;
    if (ordinary.timing == "actuator_delay") j.delay = std::round(late * 1e4) * 1e-4;
  }
}

std::vector<std::string> GearEffects(const Ordinary& ordinary) {
  std::vector<std::string> ids = {ordinary.friction, "viscous_friction"};
  if (ordinary.rotors) ids.push_back("rotor_inertia");
  if (!ordinary.timing.empty()) ids.push_back(ordinary.timing);
  return ids;
}

void Strengthen(const std::string& id, size_t joint, Truth* truth) {
  JointTruth& j = truth->joint[joint];
  if (id == "viscous_friction") {
    j.viscous *= 2;
  } else if (id == "rotor_inertia") {
    j.armature *= 2;
  } else {
    for (double* x : {&j.dry.coulomb_positive, &j.dry.coulomb_negative, &j.dry.static_extra}) *x *= 2;
  }
}

Truth WithoutGear(const Truth& truth, const std::string& id, int joint) {
  Truth out = truth;
  for (size_t i = 0; i < out.joint.size(); ++i) {
    if (joint >= 0 && static_cast<int>(i) != joint) continue;
    JointTruth& j = out.joint[i];
    if (id == "viscous_friction") {
      j.viscous = 0;
    } else if (id == "rotor_inertia") {
      j.armature = 0;
    } else if (id == "actuator_lag") {
      j.lag = 0;
    } else if (id == "actuator_delay") {
      j.delay = 0;
    } else {
      j.dry = DryFriction{};
    }
  }
  return out;
}

json GearLabels(const Ordinary& ordinary, const Scales& scales, const Truth& truth) {
  json effects = json::array();
  for (const std::string& id : GearEffects(ordinary)) {
    json entry = Entry(id);
    for (size_t i = 0; i < scales.joints.size(); ++i) {
      const json row = Row(id, truth.joint[i], scales.prismatic[i]);
      if (row.is_null()) continue;
      entry["joints"].push_back(scales.joints[i]);
      entry["parameters"][scales.joints[i]] = row;
    }
    AddOptionalJoints(scales, truth, &entry);
    if (!entry["joints"].empty()) effects.push_back(entry);
  }
  return effects;
}

std::optional<json> AddExtra(const std::string& id, double strength, const Scales& scales, Rng rng,
                             Truth* truth) {
  if (id == "load_dependent_friction") return LoadDependent(scales, rng, truth, strength);
  constexpr int kDraws = 20;
  for (int draw = 0; draw < kDraws; ++draw) {
    Truth drawn = *truth;
    json entry = AddEffect(id, strength, scales, rng.Split(static_cast<uint64_t>(draw)), &drawn);
    if (id == "torque_gain" && entry["joints"].size() == scales.joints.size()) continue;
    if (Springy(id) && !TakeRotor(scales, &entry, &drawn)) continue;
    *truth = drawn;
    return entry;
  }
  return std::nullopt;
}

std::vector<Truth> OrdinarySiblings(const Truth& truth, const json& entry, const Scales& scales,
                                    const Eigen::VectorXd& load) {
  const std::string id = entry["id"];
  if (OneOf(id, {"actuator_lag", "actuator_delay"})) {
    Truth other = truth;
    for (JointTruth& j : other.joint) std::swap(j.lag, j.delay);
    return {other};
  }
  if (id == "torque_gain") {
    Truth other = truth;
    for (const json& joint : entry["joints"]) {
      JointTruth& j = other.joint[IndexOf(scales, joint)];
      ScaleOwn(1 / j.gain, &j);
      j.gain = 1;
    }
    return {other};
  }
  if (!OneOf(id, {"stribeck_friction", "asymmetric_friction"})) {
    if (entry["joints"].empty()) return {};
    const size_t i = IndexOf(scales, entry["joints"][0]);
    return SimplerSiblings(truth, id, i, load[static_cast<Eigen::Index>(i)], scales.tool);
  }
  // A law of all joints: the simpler one on all, level by level.
  std::vector<Truth> out;
  for (size_t i = 0; i < truth.joint.size(); ++i) {
    const std::vector<Truth> of_joint =
        SimplerSiblings(truth, id, i, load[static_cast<Eigen::Index>(i)], scales.tool);
    if (out.empty()) out.assign(of_joint.size(), truth);
    for (size_t level = 0; level < out.size(); ++level) out[level].joint[i] = of_joint[level].joint[i];
  }
  return out;
}

}  // namespace rg::proof
