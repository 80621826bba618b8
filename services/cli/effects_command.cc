// `effects`: the catalogue of physics that a model may lack, as diagnosis, simulator and files have it.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <memory>
#include <nlohmann/json.hpp>

#include "common/effects/effect_catalog.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"
#include "services/diagnosis/data/words.h"
#include "services/diagnosis/reporting/experiments.h"

namespace rg::cli {
namespace {

using effects::EffectInfo;
using effects::ParameterInfo;
using nlohmann::json;

std::string ActsOn(const EffectInfo& info) {
  switch (info.scope) {
    case effects::Scope::kRobot:
      return "robot";
    case effects::Scope::kJointOrRobot:
      return "joint or robot";
    case effects::Scope::kJointPair:
      return "two joints";
    default:
      return "joint";
  }
}

json Bound(double value) { return std::isfinite(value) ? json(value) : json(nullptr); }

json JsonOf(const EffectInfo& info) {
  json out = {{"id", info.id},
              {"title", info.title},
              {"acts_on", ActsOn(info)},
              {"shows_over", effects::VariableName(info.shows_over)},
              {"equation", info.equation},
              {"sentence", info.sentence},
              {"family", info.family},
              {"reference", info.reference},
              {"options", info.options},
              {"needs", json::array()},
              {"parameters", json::array()},
              {"forms", json::array()},
              {"confused_with", json::array()}};
  for (const effects::Need need : info.needs) out["needs"].push_back(effects::NeedName(need));
  for (const ParameterInfo& p : info.parameters) {
    out["parameters"].push_back({{"name", p.name},
                                 {"symbol", p.symbol},
                                 {"unit", p.unit},
                                 {"unit_prismatic", p.unit_prismatic},
                                 {"lower", Bound(p.lower)},
                                 {"upper", Bound(p.upper)},
                                 {"form", p.form.empty() ? json(nullptr) : json(p.form)},
                                 {"meaning", p.meaning}});
  }
  for (const effects::FormInfo& form : info.forms) {
    out["forms"].push_back({{"option", form.option},
                            {"value", form.value},
                            {"equation", form.equation},
                            {"sentence", form.sentence}});
  }
  for (const std::string& id : info.confused_with)
    out["confused_with"].push_back(
        {{"effect", id}, {"experiment", diagnosis::ExperimentFor(info.id, id, {})}});
  return out;
}

std::string RangeOf(const ParameterInfo& p) {
  const bool low = std::isfinite(p.lower), high = std::isfinite(p.upper);
  if (low && high) return diagnosis::Number(p.lower) + " to " + diagnosis::Number(p.upper);
  return low ? "from " + diagnosis::Number(p.lower) : high ? "to " + diagnosis::Number(p.upper) : "any";
}

std::string CatalogueTable() {
  TextTable table({"EFFECT", "ACTS ON", "SHOWS OVER", "LAW"});
  for (const EffectInfo& info : effects::Catalog())
    table.AddRow({info.id, ActsOn(info), std::string(effects::VariableName(info.shows_over)), info.equation});
  return table.ToString();
}

std::string TextOf(const EffectInfo& info) {
  std::string text =
      info.title + " (" + info.id + "), of a " + ActsOn(info) + "\n\n  " + info.equation + "\n";
  for (const effects::FormInfo& form : info.forms)
    text += "  " + form.equation + "   (" + form.option + ": " + form.value + ")\n";
  TextTable parameters({"PARAMETER", "SYMBOL", "UNIT", "RANGE", "WHAT IT IS"});
  for (const ParameterInfo& p : info.parameters) {
    const std::string unit = p.unit + (p.unit == p.unit_prismatic ? "" : " or " + p.unit_prismatic);
    parameters.AddRow(
        {p.name, p.symbol, unit, RangeOf(p), p.meaning + (p.form.empty() ? "" : " (" + p.form + " only)")});
  }
  if (!parameters.empty()) text += "\n" + parameters.ToString();
  for (const auto& [option, values] : info.options) {
    text += "\noption " + option + ": " + values[0] + " unless told";
    for (size_t i = 1; i < values.size(); ++i) text += ", or " + values[i];
  }
  if (!info.options.empty()) text += "\n";
  if (!info.confused_with.empty()) {
    TextTable rivals({"EASILY TAKEN FOR", "TOLD APART BY"});
    for (const std::string& id : info.confused_with)
      rivals.AddRow({id, diagnosis::ExperimentFor(info.id, id, {})});
    text += "\n" + rivals.ToString();
  }
  if (!info.reference.empty()) text += "\n" + info.reference + "\n";
  while (text.back() == '\n') text.pop_back();
  return text;
}

Status Effects(const Context& context, const std::string& id) {
  const EffectInfo* one = id.empty() ? nullptr : effects::FindEffect(id);
  if (!id.empty() && one == nullptr)
    return NotFoundError("there is no effect '" + id + "'; `realitygrad effects` lists them");
  if (context.json()) {
    json all = json::array();
    for (const EffectInfo& info : effects::Catalog()) {
      if (one == nullptr || info.id == id) all.push_back(JsonOf(info));
    }
    PrintJson("realitygrad.effects/1", {{"effects", all}});
  } else {
    Print(one == nullptr ? CatalogueTable() : TextOf(*one));
  }
  return Status::Ok();
}

}  // namespace

void AddEffectsCommand(CLI::App& app, Context& context) {
  auto id = std::make_shared<std::string>();
  CLI::App* command = app.add_subcommand(
      "effects", "Physics that a model may lack: laws, parameters, what is taken for what");
  command->add_option("EFFECT", *id, "One of them, in full");
  command->callback([&context, id] { context.Failed(Effects(context, *id)); });
}

}  // namespace rg::cli
