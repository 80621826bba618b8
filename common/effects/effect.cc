#include "common/effects/effect.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <set>

#include "common/effects/effect_catalog.h"

namespace rg::effects {
namespace {

std::string Number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.3g", value);
  return text;
}

Status CheckJoints(const EffectInfo& info, const std::vector<std::string>& joints) {
  std::set<std::string> seen;
  for (const auto& joint : joints) {
    if (joint.empty()) return InvalidError("effect " + info.id + ": a joint without a name");
    if (!seen.insert(joint).second)
      return InvalidError("effect " + info.id + ": joint " + joint + " is listed twice");
  }
  const size_t n = joints.size();
  if (info.scope == Scope::kJoint && n == 0)
    return InvalidError("effect " + info.id + ": needs at least one joint");
  if (info.scope == Scope::kRobot && n != 0) {
    return InvalidError("effect " + info.id + ": belongs to the whole robot and takes no joints, got " +
                        joints[0]);
  }
  if (info.scope == Scope::kJointPair && n != 2) {
    return InvalidError("effect " + info.id + ": needs two joints (from, to), got " + std::to_string(n));
  }
  return Status::Ok();
}

Status CheckValue(const std::string& where, const ParameterInfo& parameter, double value) {
  if (!std::isfinite(value)) return InvalidError(where + " is not finite");
  if (value < parameter.lower || value > parameter.upper) {
    return InvalidError(where + " = " + Number(value) + " is outside [" + Number(parameter.lower) + ", " +
                        Number(parameter.upper) + "]");
  }
  return Status::Ok();
}

// Null: the first form, whose words are the row's.
const FormInfo* FormOf(const EffectInfo& info, const EffectSpec& spec) {
  const auto form = std::find_if(info.forms.begin(), info.forms.end(), [&](const FormInfo& f) {
    return info.options.at(f.option)[info.Option(f.option, spec)] == f.value;
  });
  return form == info.forms.end() ? nullptr : &*form;
}

}  // namespace

std::string_view StageName(Stage stage) {
  switch (stage) {
    case Stage::kActuator:
      return "actuator";
    case Stage::kTransmission:
      return "transmission";
    case Stage::kJoint:
      return "joint";
    case Stage::kBody:
      return "body";
    case Stage::kSensor:
      return "sensor";
    case Stage::kEnvironment:
      return "environment";
  }
  return "unknown";
}

std::string_view NeedName(Need need) {
  switch (need) {
    case Need::kBothWays:
      return "both_ways";
    case Need::kManySpeeds:
      return "many_speeds";
    case Need::kSlowMotion:
      return "slow_motion";
    case Need::kDenseRows:
      return "dense_rows";
    case Need::kResonances:
      return "resonances";
    case Need::kAcceleration:
      return "acceleration";
    case Need::kTravel:
      return "travel";
    case Need::kPeriods:
      return "periods";
    case Need::kPosture:
      return "posture";
    case Need::kTilt:
      return "tilt";
    case Need::kLastMass:
      return "last_mass";
    case Need::kEffort:
      return "effort";
    case Need::kEffortSign:
      return "effort_sign";
    case Need::kPeakEffort:
      return "peak_effort";
    case Need::kLoad:
      return "load";
    case Need::kWarming:
      return "warming";
    case Need::kOtherEffort:
      return "other_effort";
  }
  return "unknown";
}

std::string_view VariableName(Variable variable) {
  switch (variable) {
    case Variable::kVelocity:
      return "velocity";
    case Variable::kPosition:
      return "position";
    case Variable::kEffort:
      return "effort";
    case Variable::kTime:
      return "time";
  }
  return "unknown";
}

int EffectInfo::FindParameter(std::string_view name) const {
  for (size_t i = 0; i < parameters.size(); ++i) {
    if (parameters[i].name == name) return static_cast<int>(i);
  }
  return -1;
}

int EffectInfo::Option(const std::string& option, const EffectSpec& spec) const {
  const auto row = options.find(option);
  const auto chosen = spec.options.find(option);
  if (row == options.end() || chosen == spec.options.end()) return 0;
  return static_cast<int>(std::find(row->second.begin(), row->second.end(), chosen->second) -
                          row->second.begin());
}

bool EffectInfo::OfForm(int i, const EffectSpec& spec) const {
  const std::string& form = parameters[i].form;
  return form.empty() || options.at("form")[Option("form", spec)] == form;
}

bool EffectInfo::Applies(int i, const EffectSpec& spec) const {
  const auto only = parameters[i].only;
  const bool with_joints = !spec.joints.empty();
  return OfForm(i, spec) &&
         (only == ParameterInfo::Only::kBoth || (only == ParameterInfo::Only::kWithJoints) == with_joints);
}

EffectSpec MakeSpec(std::string id, std::vector<std::string> joints, std::map<std::string, double> values) {
  EffectSpec spec{std::move(id), std::move(joints), {}, {}};
  const EffectInfo* info = FindEffect(spec.id);
  const bool pair = info != nullptr && info->scope == Scope::kJointPair;
  if (values.empty()) return spec;
  if (spec.joints.empty() || pair) {
    spec.values["*"] = std::move(values);
  } else {
    for (const auto& joint : spec.joints) spec.values[joint] = values;
  }
  return spec;
}

Variable ShowsOver(const EffectSpec& spec) {
  const EffectInfo& info = *FindEffect(spec.id);
  const FormInfo* form = FormOf(info, spec);
  return form == nullptr ? info.shows_over : form->shows_over;
}

std::string Equation(const EffectSpec& spec) {
  const EffectInfo& info = *FindEffect(spec.id);
  const FormInfo* form = FormOf(info, spec);
  return form == nullptr ? info.equation : form->equation;
}

std::string Sentence(const EffectSpec& spec, const std::string& joint, bool prismatic,
                     const std::map<std::string, double>& values) {
  const EffectInfo& info = *FindEffect(spec.id);
  const FormInfo* form = FormOf(info, spec);
  const std::string& sentence = form == nullptr ? info.sentence : form->sentence;
  std::string text;
  for (size_t at = 0; at < sentence.size();) {
    const size_t close = sentence[at] == '{' ? sentence.find('}', at) : std::string::npos;
    if (close == std::string::npos) {
      text += sentence[at++];
      continue;
    }
    const std::string key = sentence.substr(at + 1, close - at - 1);
    const int i = info.FindParameter(key);
    const auto value = values.find(key);
    if (key == "joint") {
      text += joint;
    } else if (i >= 0 && value != values.end()) {
      const std::string& unit = prismatic ? info.parameters[i].unit_prismatic : info.parameters[i].unit;
      text += Number(value->second) + (unit == "-" ? "" : " " + unit);
    } else {
      text += i >= 0 ? "an unknown " + info.parameters[i].meaning : key;
    }
    at = close + 1;
  }
  return text;
}

Status ValidateSpec(const EffectSpec& spec) {
  const EffectInfo* info = FindEffect(spec.id);
  if (info == nullptr) return InvalidError("effect " + spec.id + ": no such effect in the catalogue");
  RG_RETURN_IF_ERROR(CheckJoints(*info, spec.joints));
  for (const auto& [option, value] : spec.options) {
    const auto row = info->options.find(option);
    if (row == info->options.end()) return InvalidError("effect " + spec.id + ": no option " + option);
    if (std::find(row->second.begin(), row->second.end(), value) == row->second.end()) {
      return InvalidError("effect " + spec.id + ": option " + option + " cannot be " + value);
    }
  }
  const bool per_joint = info->scope != Scope::kJointPair && !spec.joints.empty();
  for (const auto& [owner, values] : spec.values) {
    const bool known = per_joint
                           ? std::find(spec.joints.begin(), spec.joints.end(), owner) != spec.joints.end()
                           : owner == "*";
    if (!known) {
      return InvalidError("effect " + spec.id + ": values for " + owner + ", which is not " +
                          (per_joint ? "among its joints" : "\"*\""));
    }
    for (const auto& [name, value] : values) {
      const int i = info->FindParameter(name);
      if (i >= 0 && !info->parameters[i].form.empty() && !info->OfForm(i, spec)) {
        return InvalidError("effect " + spec.id + ", " + owner + ": parameter " + name +
                            " needs option form " + info->parameters[i].form);
      }
      if (i < 0 || !info->Applies(i, spec)) {
        return InvalidError("effect " + spec.id + ", " + owner + ": no parameter " + name);
      }
      RG_RETURN_IF_ERROR(
          CheckValue("effect " + spec.id + ", " + owner + ": " + name, info->parameters[i], value));
    }
  }
  return Status::Ok();
}

}  // namespace rg::effects
