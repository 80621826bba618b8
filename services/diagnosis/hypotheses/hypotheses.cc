#include "services/diagnosis/hypotheses/hypotheses.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "common/effects/effect_catalog.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/likelihood/candidate.h"
#include "services/diagnosis/likelihood/features.h"

namespace rg::diagnosis {

using effects::MakeSpec;
using effects::Regressor;
using effects::Slot;

namespace {

constexpr double kTypicalRotor = 0.4, kLeastRotor = 0.01;  // of its joint's inertia

const std::string& Coupling() { return effects::LawOf(Regressor::kOtherEffort).id; }

double LastMass(const sim::Plant& plant) {
  const auto& model = plant.model();
  double mass = 0;
  for (int i = 0; i < model.num_links(); ++i) {
    if (model.link(i).body == model.num_joints() - 1) mass += model.link(i).parameters[0];
  }
  return std::max(1e-3, mass);
}

// The effect of the plant that has a parameter.
const EffectSpec& SpecOf(const sim::Parameter& p, const sim::Plant& plant) {
  return *std::ranges::find_if(plant.effects(), [&](const EffectSpec& e) {
    return e.id == p.effect && (p.owner == "*" || Contains({e}, e.id, p.owner));
  });
}

effects::Prior PriorOf(const sim::Parameter& p, const sim::Plant& plant, const MotionScales& s) {
  const EffectSpec& spec = SpecOf(p, plant);
  const effects::EffectInfo& info = *effects::FindEffect(p.effect);
  // Losses of a drive that turns with two joints are of its own one's size.
  const bool drive = IsCoupledDrive(spec) && p.field != info.parameters[0].name;
  const int joint = plant.model().FindJoint(drive ? spec.joints.back() : p.owner);
  return effects::PriorOf(spec, info.parameters[static_cast<size_t>(info.FindParameter(p.field))], p.nominal,
                          SizeOf(s, plant, joint));
}

bool Fixed(const sim::Parameter& p) { return IsUnnamed(p.effect) && p.field[0] != 'w'; }

effects::Blind BlindOn(int joint, const sim::Plant& nominal, const MotionScales& s) {
  const auto& model = nominal.model();
  const int last = model.joint(model.num_joints() - 1).child_link;
  effects::Blind out;
  out.joint = SizeOf(s, nominal, joint);
  out.fine = nominal.num_joints() <= kLightRobot;
  out.last_link = model.link(last).parameters.data();
  out.end_effector_is_last = last == model.FindLink(model.end_effector().name);
  return out;
}

// Trials of the effect from each of the starts.
std::vector<TrialSpecs> Trials(const std::string& effect, const std::vector<std::string>& joints,
                               const std::vector<effects::Start>& starts,
                               const std::map<std::string, std::string>& options = {}) {
  std::vector<TrialSpecs> out;
  for (const effects::Start& start : starts) {
    out.push_back({MakeSpec(effect, joints, start.values)});
    out.back()[0].options = options.empty() ? start.options : options;
  }
  return out;
}

// Parameters that say how large a force of a constant size is, for a law in the place of another.
const std::set<std::string> kLevels = {"coulomb", "coulomb_positive", "initial", "offset", "deadband"};
constexpr double kStatedSpread = 0.5;  // of a value that the user states, its prior's standard deviation

// Whether a joint has one of them at most.
bool Exclusive(const std::string& a, const std::string& b) {
  const Slot slot = effects::InferenceOf(a).slot;
  return a == b || (slot != Slot::kNone && effects::IsIn(slot, b));
}

// A motor's losses, which a drive that turns with two joints has in their place.
bool IsLossOfDrive(const std::string& id) {
  return effects::InferenceOf(id).of_every_drive || effects::IsIn(Slot::kDryFriction, id);
}

}  // namespace

effects::JointSize SizeOf(const MotionScales& s, const sim::Plant& plant, int j) {
  effects::JointSize out;
  out.duration = s.duration, out.last_mass = LastMass(plant);
  if (j < 0) {
    out.moves = false;
    if (s.torque.size() > 0)  // else of no motion
      out.torque = s.torque.maxCoeff(), out.speed = s.speed.maxCoeff(), out.inertia = s.inertia.maxCoeff();
    return out;
  }
  out.torque = s.torque[j], out.speed = s.speed[j], out.inertia = s.inertia[j];
  out.acceleration = s.acceleration[j], out.moves = s.still[j] == 0;
  out.low = s.low[j], out.high = s.high[j];
  return out;
}

std::vector<TrialSpecs> SpecsFor(const Scored& h, const sim::Plant& nominal, const MotionScales& s) {
  const auto& names = nominal.joint_names();
  const auto& model = nominal.model();
  const effects::EffectInfo& effect = *effects::FindEffect(h.effect);
  const auto link = model.link(model.joint(model.num_joints() - 1).child_link).parameters;
  const auto starts = [&](const std::vector<double>& c, int joint) {
    effects::Found found{c, h.shape, h.shape_end};
    found.joint = SizeOf(s, nominal, joint);
    found.joints = nominal.num_joints(), found.gravity = nominal.options().gravity.norm();
    found.last_link = link.data(), found.options = h.options;
    return effects::StartsOf(effect, found);
  };
  std::vector<TrialSpecs> out;
  const bool each = effect.scope != effects::Scope::kJointPair;
  if (h.joints.empty() || !each) {
    std::vector<std::string> joints;
    for (const int j : h.joints) joints.push_back(names[j]);
    return Trials(h.effect, joints, starts(h.coefficients, -1));
  }
  out.emplace_back();
  const size_t m = h.coefficients.size() / h.joints.size();
  for (size_t i = 0; i < h.joints.size(); ++i) {
    // One common coefficient, or some for each joint.
    const std::vector<double> c =
        m == 0 ? h.coefficients
               : std::vector<double>(h.coefficients.begin() + static_cast<long>(i * m),
                                     h.coefficients.begin() + static_cast<long>((i + 1) * m));
    const effects::Start start = starts(c, h.joints[i]).front();
    out[0].push_back(MakeSpec(h.effect, {names[h.joints[i]]}, start.values));
    out[0].back().options = start.options;
  }
  return out;
}

std::vector<TrialSpecs> TransmissionStarts(const std::string& effect, const std::string& sensor, int joint,
                                           const sim::Plant& nominal, const MotionScales& s,
                                           double added_inertia) {
  effects::Blind blind = BlindOn(joint, nominal, s);
  const double inertia = blind.joint.inertia;
  blind.rotors = {0.15 * inertia, 0.4 * inertia};
  // Below its resonance the motor moves with the link: what the screen takes for more inertia is the motor.
  if (added_inertia > 0.01 * inertia) blind.rotors.push_back(std::min(added_inertia, 2 * inertia));
  return Trials(effect, {nominal.joint_names()[joint]}, effects::InferenceOf(effect).blind(blind),
                {{"sensor", sensor}});
}

std::vector<TrialSpecs> StartsBehind(const std::string& effect, const std::string& sensor, int joint,
                                     const sim::Plant& nominal, const MotionScales& s, double rotor) {
  effects::Blind blind = BlindOn(joint, nominal, s);
  blind.rotors = {rotor};
  return Trials(effect, {nominal.joint_names()[joint]}, effects::InferenceOf(effect).blind(blind),
                {{"sensor", sensor}});
}

std::vector<EffectSpec> WithoutSprings(std::vector<EffectSpec> specs) {
  const effects::EffectInfo& rotor = effects::LawOf(Regressor::kAcceleration);
  for (EffectSpec& s : specs) {
    const std::string& behind = effects::InferenceOf(s.id).rotor;
    if (!behind.empty())
      s = MakeSpec(rotor.id, s.joints, {{rotor.parameters[0].name, effects::ValueOf(s, behind)}});
  }
  return specs;
}

std::vector<TrialSpecs> OtherTransmission(const EffectSpec& spec, const sim::Plant& nominal,
                                          const MotionScales& s) {
  std::vector<TrialSpecs> out;
  if (!effects::IsIn(Slot::kTransmission, spec.id)) return out;
  const auto at = spec.options.find("sensor");
  const std::string sensor = at == spec.options.end() ? "link" : at->second;
  const effects::Blind blind = BlindOn(nominal.model().FindJoint(spec.joints[0]), nominal, s);
  for (const std::string& other : effects::EffectsIn(Slot::kTransmission)) {
    if (other == spec.id) continue;
    const auto starts = effects::InferenceOf(other).instead(spec.values.at(spec.joints[0]), blind);
    for (auto& trial : Trials(other, spec.joints, starts, {{"sensor", sensor}})) out.push_back(trial);
  }
  return out;
}

std::vector<EffectSpec> WithConstantForce(std::vector<EffectSpec> specs, const std::string& joint,
                                          const sim::Plant& nominal, const MotionScales& scales) {
  const std::string& constant = effects::LawOf(Regressor::kConstant).id;
  const int at = nominal.model().FindJoint(joint);
  if (!nominal.Takes(constant, at) || Contains(specs, constant, joint)) return specs;
  const double middle = 0.5 * (scales.low[at] + scales.high[at]);
  for (EffectSpec& s : specs) {
    if (s.id != effects::LawOf(Regressor::kPosition).id || s.joints[0] != joint) continue;
    s = MakeSpec(constant, s.joints,
                 {{"offset", effects::InferenceOf(s.id).force_at(s.values.at(joint), middle)}});
  }
  return specs;
}

TrialSpecs PlayHeldClosed(const TrialSpecs& specs, const EffectSpec& offset, const sim::Plant& nominal,
                          const MotionScales& scales) {
  const effects::EffectInfo& reads_off = effects::EffectOf(effects::Role::kSensorOffset);
  if (offset.id != reads_off.id) return {};
  const auto on_joint = [&](const EffectSpec& s) { return s.joints == offset.joints; };
  const effects::EffectInfo& rotor = effects::LawOf(Regressor::kAcceleration);
  const int joint = nominal.model().FindJoint(offset.joints[0]);
  if (!nominal.Takes(effects::Play().id, joint) || Contains(nominal.effects(), offset.id, offset.joints[0]))
    return {};
  const double inertia = SizeOf(scales, nominal, joint).inertia;
  double behind = kTypicalRotor * inertia;
  TrialSpecs others;
  for (const EffectSpec& s : specs) {
    if (on_joint(s) && s.id == rotor.id) behind = effects::ValueOf(s, rotor.parameters[0].name);
    if (on_joint(s) && effects::IsIn(Slot::kTransmission, s.id)) return {};
    if (!on_joint(s) || s.id != offset.id) others.push_back(s);
  }
  behind = std::max(behind, kLeastRotor * inertia);
  EffectSpec play = StartsBehind(effects::Play().id, "motor", joint, nominal, scales, behind)[0][0];
  play.values.at(offset.joints[0]).at(effects::InferenceOf(play.id).stays) =
      2 * std::abs(effects::ValueOf(offset, reads_off.parameters[0].name));
  return Joined(others, {play});
}

TrialSpecs RipplesAcrossLags(TrialSpecs specs) {
  const effects::EffectInfo& ripple = effects::LawOf(Regressor::kSine);
  const std::string& lag = effects::LawOf(Regressor::kLagging).id;
  const auto& [option, sides] = *ripple.options.begin();
  bool any = false;
  for (EffectSpec& s : specs) {
    if (s.id != ripple.id || !Contains(specs, lag, s.joints[0])) continue;
    const int other = 1 - ripple.Option(option, s);
    s.options.erase(option);  // the same model has one key
    if (other != 0) s.options[option] = sides[other];
    any = true;
  }
  return any ? specs : TrialSpecs{};
}

std::vector<TrialSpecs> BodyStarts(const std::string& effect, const sim::Plant& nominal,
                                   const MotionScales& s) {
  const effects::Inference& own = effects::InferenceOf(effect);
  auto out = Trials(effect, {}, own.blind(BlindOn(-1, nominal, s)));
  // Of a chain one from its end and one from its middle may do.
  if (own.chained) out = {out.front(), out[out.size() / 2]};
  return out;
}

std::vector<TrialSpecs> MountStarts(const sim::Plant& nominal, const MotionScales& s) {
  std::vector<TrialSpecs> out;
  for (const effects::EffectInfo& effect : effects::Catalog()) {
    const effects::Inference& own = effects::InferenceOf(effect.id);
    if (!own.chained) continue;
    for (auto& trial : Trials(effect.id, {}, own.blind(BlindOn(-1, nominal, s)))) out.push_back(trial);
  }
  return out;
}

std::vector<sysid::FitParameter> FreeParameters(const sim::Plant& plant, const MotionScales& s, bool base,
                                                const sim::Plant* given) {
  std::vector<sysid::FitParameter> out;
  if (base) {
    out = sysid::InertialFitParameters(plant);
    for (const auto& p : sysid::DeclaredJointFitParameters(plant)) {
      if (p.nominal == 0) continue;
      out.push_back(p);
      out.back().prior_stddev = kStatedSpread * std::abs(p.nominal);
    }
  }
  for (auto& p : sysid::RotorFitParameters(plant)) out.push_back(std::move(p));
  for (int i = 0; i < plant.parameters().size(); ++i) {
    const sim::Parameter& p = plant.parameters()[i];
    if (p.kind != sim::ParameterKind::kEffect || Fixed(p)) continue;
    effects::Prior prior = PriorOf(p, plant, s);
    const int stated = given == nullptr ? -1 : given->parameters().Find(p.name);
    if (stated >= 0) {
      prior.center = given->parameters()[stated].nominal;
      prior.stddev = std::max(prior.stddev, kStatedSpread * std::abs(prior.center));
    }
    sysid::FitParameter row{i,
                            p.name,
                            p.unit,
                            prior.center,
                            std::max(p.lower, prior.lower),
                            std::min(p.upper, prior.upper),
                            prior.stddev};
    out.push_back(row);
  }
  return out;
}

EffectSpec CoupledDrive(const std::string& other, const std::string& joint, double ratio,
                        const DriveLosses& losses) {
  EffectSpec out = MakeSpec(Coupling(), {other, joint},
                            {{"coefficient", ratio},
                             {"viscous", losses.viscous},
                             {"coulomb", losses.coulomb},
                             {"armature", losses.armature}});
  out.options["form"] = "kinematic";
  return out;
}

bool IsCoupledDrive(const EffectSpec& s) {
  const auto form = s.options.find("form");
  return s.id == Coupling() && form != s.options.end() && form->second == "kinematic";
}

std::vector<EffectSpec> Joined(std::vector<EffectSpec> specs, const std::vector<EffectSpec>& added) {
  for (const EffectSpec& s : added) {
    const bool motor = effects::IsIn(Slot::kTransmission, s.id);
    std::erase_if(specs, [&](const EffectSpec& old) {
      // Nor does a coupling end at a joint behind a spring.
      if (old.id == Coupling() && motor) return old.joints.back() == s.joints.front();
      // Where a drive turns with two joints, its own losses are no longer its joint's.
      if (IsCoupledDrive(s) && old.joints.size() == 1 && old.joints.front() == s.joints.back())
        return IsLossOfDrive(old.id);
      if (old.joints != s.joints) return false;
      // A motor behind a spring or play brings its own inertia.
      if (old.id == effects::LawOf(Regressor::kAcceleration).id && motor) return true;
      return Exclusive(old.id, s.id);
    });
    specs.push_back(s);
  }
  return specs;
}

bool AlreadyIn(const std::vector<EffectSpec>& specs, const Scored& h, const sim::Plant& nominal) {
  if (h.joints.empty()) return Contains(specs, h.effect, "");
  std::vector<std::string> names;
  for (const int j : h.joints) names.push_back(nominal.joint_names()[j]);
  if (h.effect == Coupling()) {
    return std::ranges::any_of(specs,
                               [&](const EffectSpec& s) { return s.id == h.effect && s.joints == names; });
  }
  return std::ranges::any_of(names,
                             [&](const std::string& joint) { return Contains(specs, h.effect, joint); });
}

bool IsRicherFriction(const std::string& effect) {
  return effects::IsIn(Slot::kDryFriction, effect) && !effects::InferenceOf(effect).of_every_drive;
}

bool IsRicherFormOf(const std::string& richer, const std::string& plain) {
  return IsRicherFriction(richer) && effects::IsIn(Slot::kDryFriction, plain) && !IsRicherFriction(plain);
}

std::vector<std::string> RicherFrictions() {
  std::vector<std::string> out = effects::EffectsIn(Slot::kDryFriction);
  std::erase_if(out, [](const std::string& id) { return !IsRicherFriction(id); });
  return out;
}

std::vector<std::string> SiblingsOf(const std::string& effect) {
  // A lag may stand beside a delay, and be taken for one; so may constant forces.
  const bool constant = effects::InferenceOf(effect).may_be_constant;
  std::vector<std::string> out;
  for (const effects::EffectInfo& other : effects::Catalog()) {
    const effects::Inference& own = effects::InferenceOf(other.id);
    const bool of_slot = own.slot != Slot::kNone && effects::IsIn(own.slot, effect);
    const bool alike = (IsTiming(effect) && IsTiming(other.id)) || (constant && own.may_be_constant);
    if (own.of_strength != nullptr && (of_slot || alike)) out.push_back(other.id);
  }
  return out;
}

EffectSpec Exchanged(const EffectSpec& spec, const std::string& id, const sim::Plant& nominal,
                     const MotionScales& s) {
  const int j = nominal.model().FindJoint(spec.joints[0]);
  double level = 0.05 * s.torque[j], seconds = 0.01;
  for (const auto& [name, value] : spec.values.begin()->second) {
    if (kLevels.count(name) > 0) level = std::max(level, std::abs(value));
    if (name == "delay" || name == "time_constant") seconds = value;
  }
  return MakeSpec(id, spec.joints,
                  effects::InferenceOf(id).of_strength(level, seconds, SizeOf(s, nominal, j)));
}

std::string KeyOf(const std::vector<EffectSpec>& specs) {
  std::set<std::string> parts;
  for (const EffectSpec& s : specs) {
    std::string part = s.id + "[";
    for (const std::string& j : s.joints) part += j + " ";
    part += "]";
    for (const auto& [k, v] : s.options) part += k + "=" + v;
    parts.insert(part);
  }
  std::string key;
  for (const std::string& p : parts) key += p + " ";
  return key;
}

std::string KeyOf(const std::vector<EffectSpec>& specs, bool base) {
  return KeyOf(specs) + (base ? "+base" : "");
}

}  // namespace rg::diagnosis
