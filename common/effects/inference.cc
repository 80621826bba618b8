#include "common/effects/inference.h"

#include <algorithm>

#include "common/base/check.h"
#include "common/effects/effect_catalog.h"

namespace rg::effects {
namespace {

// What can be a friction's level or a share is a part of the joint's torque or of one at least: a fit that
// starts from nothing stays there.
double NotBelow(const ParameterInfo& p, double value, const Found& found) {
  if (p.lower < 0) return value;
  const double least = p.unit == "N*m" ? found.least_share * found.joint.torque
                       : p.unit == "-" ? found.least_share
                                       : found.least;
  return std::max(value, least);
}

const EffectInfo& First(bool (*is)(const EffectInfo&, Role)) {
  size_t kind = 0;
  while (!is(Catalog()[kind], TraitsOf(static_cast<int>(kind)).role)) RG_CHECK(++kind < Catalog().size());
  return Catalog()[kind];
}

}  // namespace

const EffectInfo& LawOf(Regressor regressor) {
  static const auto& laws = *new std::map<Regressor, const EffectInfo*>([] {
    std::map<Regressor, const EffectInfo*> plainest;
    for (const EffectInfo& effect : Catalog()) {
      const auto& terms = InferenceOf(effect.id).terms;
      for (const Term& term : terms) {
        const EffectInfo*& law = plainest[term.regressor];
        if (law == nullptr || terms.size() < InferenceOf(law->id).terms.size()) law = &effect;
      }
    }
    return plainest;
  }());
  return *laws.at(regressor);
}

bool ScalesEffort(std::string_view id) { return id == LawOf(Regressor::kEffort).id; }

const EffectInfo& EffectOf(Role role) {
  int kind = 0;
  while (TraitsOf(kind).role != role) RG_CHECK(++kind < static_cast<int>(Catalog().size()));
  return Catalog()[static_cast<size_t>(kind)];
}

const EffectInfo& SwingingMass() {
  static const EffectInfo& one =
      First([](const EffectInfo& e, Role) { return InferenceOf(e.id).swings; });
  return one;
}

const EffectInfo& SoftMount() {
  static const EffectInfo& one = First([](const EffectInfo& e, Role role) {
    return role == Role::kExtraBodies && !InferenceOf(e.id).swings;
  });
  return one;
}

const EffectInfo& Spring() {
  static const EffectInfo& one = First([](const EffectInfo& e, Role) {
    return IsIn(Slot::kTransmission, e.id) && !InferenceOf(e.id).rotor.empty();
  });
  return one;
}

const EffectInfo& Play() {
  static const EffectInfo& one = First([](const EffectInfo& e, Role) {
    return IsIn(Slot::kTransmission, e.id) && InferenceOf(e.id).rotor.empty();
  });
  return one;
}

const EffectInfo& Surface() {
  static const EffectInfo& one = First([](const EffectInfo& e, Role role) {
    return role == Role::kJointOrPointForce && InferenceOf(e.id).terms.empty();
  });
  return one;
}

const EffectInfo& Push() { return LawOf(Regressor::kPulse); }

std::vector<std::string> EffectsIn(Slot slot) {
  std::vector<std::string> out;
  for (const EffectInfo& effect : Catalog()) {
    if (IsIn(slot, effect.id)) out.push_back(effect.id);
  }
  return out;
}

bool IsIn(Slot slot, std::string_view id) { return InferenceOf(id).slot == slot; }

double ValueOf(const EffectSpec& spec, const std::string& parameter) {
  const EffectInfo& info = *FindEffect(spec.id);
  const double none = info.parameters[static_cast<size_t>(info.FindParameter(parameter))].default_value;
  if (spec.values.empty()) return none;
  const auto& values = spec.values.begin()->second;
  const auto at = values.find(parameter);
  return at == values.end() ? none : at->second;
}

Prior PriorOf(const EffectSpec& spec, const ParameterInfo& p, double nominal, const JointSize& joint) {
  const Inference& own = InferenceOf(spec.id);
  if (own.prior != nullptr) {
    if (const auto prior = own.prior(p.name, nominal, spec, joint)) return *prior;
  }
  if (p.unit == "N*m") return {0, 0.5 * joint.torque};
  if (p.prior_of_effort && p.unit == "N*m*s/rad") return {0, 0.5 * joint.torque / joint.speed};
  if (p.prior_of_effort && p.unit == "N*m*s^2/rad^2")
    return {0, 0.5 * joint.torque / joint.speed / joint.speed};
  // Seen through its gear a light link's rotor is many times the link: what half the torque would turn.
  if (p.unit == "kg*m^2")
    return {0, std::max(joint.inertia, joint.moves ? 0.5 * joint.torque / joint.acceleration : 0.0)};
  // Stiffnesses and dampings: as likely half as twice the start.
  return {nominal, std::max(1e-6, nominal), 0.02 * nominal, 50 * nominal};
}

std::vector<Start> StartsOf(const EffectInfo& effect, const Found& found) {
  const Inference& own = InferenceOf(effect.id);
  if (own.starts != nullptr) return own.starts(found);
  Values values;
  for (const ParameterInfo& p : effect.parameters) {
    if (p.name == own.shape) values[p.name] = found.shape;
    double sum = 0;
    bool any = false;
    for (size_t i = 0; i < own.terms.size() && i < found.c.size(); ++i) {
      const auto& names = own.terms[i].adds_to;
      if (std::find(names.begin(), names.end(), p.name) == names.end()) continue;
      sum += found.c[i], any = true;
    }
    if (any) values[p.name] = NotBelow(p, sum, found);
  }
  if (own.terms.empty() && !found.c.empty()) values[effect.parameters[0].name] = found.c[0];
  return {{values}};
}

}  // namespace rg::effects
