#include "services/proof/generator/equivalents.h"

#include <algorithm>
#include <set>
#include <string>

namespace rg::proof {
namespace {

using nlohmann::json;

void Join(const std::set<std::string>& names, json* effect) {
  json& list = (*effect)["equivalents"];
  for (const std::string& name : names) {
    if (name != (*effect)["id"] && std::find(list.begin(), list.end(), name) == list.end())
      list.push_back(name);
  }
}

bool Has(const json& effects, const char* id) {
  return std::any_of(effects.begin(), effects.end(), [&](const json& e) { return e["id"] == id; });
}

// Whether it is on all joints, or all others are apart from its and nothing else couples them.
bool OfAllThatFeelIt(const RobotFacts& facts, const json& effects, const json& effect) {
  const size_t on = effect["joints"].size();
  if (static_cast<int>(on) == facts.joints) return true;
  const bool bodies_alone = std::all_of(effects.begin(), effects.end(), [&](const json& other) {
    return other["id"] == effect["id"] || other["id"] == "parameters_only";
  });
  const auto apart = static_cast<size_t>(
      std::count_if(effect["joints"].begin(), effect["joints"].end(),
                    [&](const json& joint) { return facts.apart.count(joint.get<std::string>()) > 0; }));
  const size_t together = static_cast<size_t>(facts.joints) - facts.apart.size();
  return bodies_alone && (on == apart || on - apart == together);
}

void OneJoint(const RobotFacts& facts, json* effects) {
  const bool body_differs = Has(*effects, "parameters_only");
  for (json& e : *effects) {
    const std::string id = e["id"];
    if (facts.linear) {
      // On a level slide gravity's share is a constant force.
      if (id == "gravity_misalignment" || id == "torque_offset")
        Join({"gravity_misalignment", "torque_offset"}, &e);
      if (id != "payload" && id != "rotor_inertia" && id != "torque_gain" && id != "parameters_only")
        continue;
      Join({"parameters_only", "torque_gain"}, &e);
      if (facts.heavier) Join({"payload", "rotor_inertia"}, &e);
      continue;
    }
    const bool turns = id == "gravity_misalignment" || id == "encoder_offset";
    const bool moments = id == "rotor_inertia" || id == "torque_gain" || id == "payload";
    if (turns) Join({"gravity_misalignment", "encoder_offset", "parameters_only"}, &e);
    if (moments) Join({"parameters_only"}, &e);
    const bool payload = facts.heavier && (id == "torque_gain" || body_differs);
    if (payload && (turns || moments || id == "parameters_only")) Join({"payload"}, &e);
  }
}

}  // namespace

void AddEquivalents(const RobotFacts& facts, json* effects) {
  // What is held fast is a part of the last body: beside wrong bodies it is one of them.
  const bool held = Has(*effects, "payload") && Has(*effects, "parameters_only");
  for (json& e : *effects) {
    if (held && (e["id"] == "payload" || e["id"] == "parameters_only"))
      Join({"payload", "parameters_only"}, &e);
    if (OfAllThatFeelIt(facts, *effects, e) && (e["id"] == "actuator_delay" || e["id"] == "sensor_delay"))
      Join({"actuator_delay", "sensor_delay"}, &e);
    const bool first_only = e["joints"].size() == 1 && e["joints"][0] == facts.first_joint;
    if (e["id"] == "rotor_inertia" && first_only && !facts.linear) Join({"parameters_only"}, &e);
    const auto damped = [&](const json& joint) { return facts.damped.count(joint.get<std::string>()) > 0; };
    if (e["id"] == "viscous_friction" && std::all_of(e["joints"].begin(), e["joints"].end(), damped))
      Join({"parameters_only"}, &e);
    if (facts.joints < 2 || !facts.upright_plane) continue;
    if (e["id"] == "gravity_misalignment" || (e["id"] == "encoder_offset" && first_only))
      Join({"gravity_misalignment", "encoder_offset"}, &e);
  }
  if (facts.joints == 1) OneJoint(facts, effects);
  // Beside an effect the same names are true remarks about the body.
  for (json& e : *effects) {
    if (e["id"] != "parameters_only") continue;
    for (const json& name : e["equivalents"]) e["also_acceptable"].push_back(name);
  }
}

bool Hides(const RobotFacts& facts, const json& effects) {
  if (facts.joints == 1 && facts.linear)
    return (Has(effects, "gravity_misalignment") || Has(effects, "torque_offset")) &&
           Has(effects, "position_spring");
  const auto on_first = [&](const char* id) {
    return std::any_of(effects.begin(), effects.end(), [&](const json& e) {
      const auto& joints = e["joints"];
      return e["id"] == id && std::find(joints.begin(), joints.end(), facts.first_joint) != joints.end();
    });
  };
  return on_first("rotor_inertia") && (on_first("joint_elasticity") || on_first("backlash"));
}

json AcceptedVerdicts(const json& effects) {
  std::set<std::string> verdicts;
  bool all_parameters = true;
  for (const json& e : effects) {
    const std::string id = e["id"];
    const auto is = [&](const char* name) {
      return std::find(e["equivalents"].begin(), e["equivalents"].end(), name) != e["equivalents"].end();
    };
    all_parameters = all_parameters && (id == "parameters_only" || is("parameters_only"));
    if (id != "parameters_only" || !e["equivalents"].empty()) verdicts.insert("unmodelled_physics");
    if (id == "unknown_field" || id == "base_flexibility" || id == "sloshing_payload")
      verdicts.insert("unexplained");
  }
  if (effects.empty()) verdicts.insert("no_mismatch");
  if (!effects.empty() && all_parameters) verdicts.insert("parameters_only");
  return verdicts;
}

}  // namespace rg::proof
