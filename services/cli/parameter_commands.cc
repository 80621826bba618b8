#include <algorithm>
#include <CLI/CLI.hpp>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>

#include "common/base/clock.h"
#include "common/base/printf.h"
#include "coordinator/client/client.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"
#include "services/cli/job_view.h"

namespace rg::cli {
namespace {

namespace pb = ::realitygrad::v1;
using nlohmann::json;

std::string Number(double value) { return Printf("%.6g", value); }

struct ParameterArguments {
  std::string robot, to_robot, job;
  unsigned version = 0, to = 0, limit = 0;
  bool all = false;
};

template <class Body>
void WithRobot(Context& context, const ParameterArguments& arguments, const Body& body) {
  auto client = context.Connect();
  if (context.Failed(client.status())) return;
  const auto robot = ChooseRobot(**client, arguments.robot);
  if (context.Failed(robot.status())) return;
  body(**client, *robot);
}

// Of one robot: what it made, or only what one job made.
Result<pb::ParameterHistoryReply> HistoryOf(coordinator::Client& client, const std::string& robot,
                                            const ParameterArguments& arguments) {
  RG_ASSIGN_OR_RETURN(auto history, client.ParameterHistoryAndCurrent(robot, arguments.limit));
  if (arguments.job.empty()) return history;
  pb::ParameterHistoryReply of_job;
  of_job.set_current(history.current());
  for (const auto& version : history.versions()) {
    if (version.job_id() == arguments.job) *of_job.add_versions() = version;
  }
  return of_job;
}

void History(Context& context, const ParameterArguments& arguments) {
  const auto show = [&](coordinator::Client& client, const std::string& robot) -> json {
    const auto history = HistoryOf(client, robot, arguments);
    if (context.Failed(history.status())) return nullptr;
    if (context.json()) {
      json list = json::array();
      for (const auto& v : history->versions()) list.push_back(coordinator::VersionJson(v));
      return {{"robot", robot}, {"current", history->current()}, {"versions", list}};
    }
    TextTable table({">VERSION", ">FROM", "SOURCE", ">RESIDUAL BEFORE", ">AFTER", "RECORDING", "JOB", "CREATED",
                     "ROLLOUT", "NOTE"});
    for (const auto& v : history->versions()) {
      const char* mark = v.version() == history->current() ? "*" : v.held_back() ? "-" : "";
      table.AddRow(
          {std::to_string(v.version()) + mark, v.parent_version() ? std::to_string(v.parent_version()) : "–",
           coordinator::SourceText(v.source()), v.has_residual_before() ? Number(v.residual_before()) : "–",
           v.has_residual_after() ? Number(v.residual_after()) : "–", v.recording_sha256().substr(0, 12),
           v.job_id(), TimeText(v.created_ns()), v.rollout(), v.note()});
    }
    Print(robot + " (* is current, - held back until it is promoted)\n" + table.ToString());
    return nullptr;
  };
  auto client = context.Connect();
  if (context.Failed(client.status())) return;
  const auto robots = (*client)->Robots();
  if (context.Failed(robots.status())) return;
  if (robots->empty() && !context.json() && !context.quiet()) return Print("no versions yet");
  if (!arguments.all && robots->empty()) {
    if (!context.json()) return;
    return PrintJson("realitygrad.parameter-history/1",
                     {{"robot", arguments.robot}, {"current", 0}, {"versions", json::array()}});
  }
  if (!arguments.all) {
    return WithRobot(context, arguments, [&](coordinator::Client& client, const std::string& robot) {
      const json history = show(client, robot);
      if (!history.is_null()) PrintJson("realitygrad.parameter-history/1", history);
    });
  }
  json all = json::array();
  for (const std::string& robot : *robots) all.push_back(show(**client, robot));
  if (context.json() && context.exit_code == kExitOk)
    PrintJson("realitygrad.parameter-histories/1", {{"robots", all}});
}

void Show(Context& context, const ParameterArguments& arguments) {
  WithRobot(context, arguments, [&](coordinator::Client& client, const std::string& robot) {
    const auto version = client.Parameters(robot, arguments.version);
    if (context.Failed(version.status())) return;
    if (context.json()) return PrintJson("realitygrad.parameters/1", coordinator::VersionJson(*version));
    TextTable table({"PARAMETER", ">VALUE", ">STDDEV"});
    for (const auto& value : version->values()) {
      table.AddRow({value.name(), Number(value.value()), value.has_stddev() ? Number(value.stddev()) : "–"});
    }
    Print(robot + " version " + std::to_string(version->version()) + " (" + coordinator::SourceText(version->source()) +
          ", " + TimeText(version->created_ns()) + ")\n" + table.ToString());
  });
}

// Between two robots nothing but the names says which parameters are the same.
Result<pb::DiffParametersReply> DiffOfRobots(coordinator::Client& client, const std::string& robot,
                                             const ParameterArguments& arguments) {
  pb::DiffParametersReply diff;
  RG_ASSIGN_OR_RETURN(*diff.mutable_from(), client.Parameters(robot, arguments.version));
  RG_ASSIGN_OR_RETURN(*diff.mutable_to(), client.Parameters(arguments.to_robot, arguments.to));
  std::map<std::string, pb::ParameterValue> old;
  for (const auto& value : diff.from().values()) old[value.name()] = value;
  for (const auto& value : diff.to().values()) {
    const auto found = old.find(value.name());
    if (found != old.end() && found->second.value() == value.value()) {
      old.erase(found);
      continue;
    }
    auto* row = diff.add_rows();
    row->set_name(value.name());
    row->set_to(value.value());
    if (found == old.end()) continue;
    row->set_from(found->second.value());
    const double spread = std::hypot(found->second.stddev(), value.stddev());
    if (spread > 0.0) row->set_sigmas(std::abs(value.value() - found->second.value()) / spread);
    old.erase(found);
  }
  for (const auto& value : diff.from().values()) {
    if (old.count(value.name()) == 0) continue;
    auto* row = diff.add_rows();
    row->set_name(value.name());
    row->set_from(value.value());
  }
  return diff;
}

void Diff(Context& context, const ParameterArguments& arguments) {
  WithRobot(context, arguments, [&](coordinator::Client& client, const std::string& robot) {
    const auto diff = arguments.to_robot.empty()
                          ? client.DiffParameters(robot, arguments.version, arguments.to)
                          : DiffOfRobots(client, robot, arguments);
    if (context.Failed(diff.status())) return;
    if (context.json()) {
      json rows = json::array();
      for (const auto& row : diff->rows()) {
        rows.push_back({{"name", row.name()},
                        {"from", row.has_from() ? json(row.from()) : json(nullptr)},
                        {"to", row.has_to() ? json(row.to()) : json(nullptr)},
                        {"sigmas", row.has_sigmas() ? json(row.sigmas()) : json(nullptr)}});
      }
      return PrintJson(
          "realitygrad.parameter-diff/1",
          {{"robot", robot}, {"from", diff->from().version()}, {"to", diff->to().version()}, {"rows", rows}});
    }
    TextTable table({"PARAMETER", ">FROM", ">TO", ">CHANGE", ">SIGMAS"});
    for (const auto& row : diff->rows()) {
      const bool both = row.has_from() && row.has_to();
      table.AddRow({row.name(), row.has_from() ? Number(row.from()) : "–",
                    row.has_to() ? Number(row.to()) : "–", both ? Number(row.to() - row.from()) : "–",
                    row.has_sigmas() ? Number(row.sigmas()) : "–"});
    }
    Print(robot + ": version " + std::to_string(diff->from().version()) + " to " +
          (arguments.to_robot.empty() ? "" : arguments.to_robot + "'s ") +
          std::to_string(diff->to().version()) + "\n" +
          (table.empty() ? std::string("no difference\n") : table.ToString()));
  });
}

}  // namespace

Result<std::string> ChooseRobot(coordinator::Client& client, const std::string& named) {
  RG_ASSIGN_OR_RETURN(const auto robots, client.Robots());
  if (robots.empty()) return NotFoundError("no parameters yet: run an iteration first");
  std::string all;
  for (const std::string& r : robots) all += " " + r;
  if (!named.empty() && std::find(robots.begin(), robots.end(), named) == robots.end())
    return NotFoundError("robot '" + named + "' has no parameters; these have:" + all);
  if (!named.empty()) return named;
  if (robots.size() == 1) return robots.front();
  return InvalidError("several robots have parameters:" + all + "; name one with --robot");
}

void AddParameterCommands(CLI::App& app, Context& context) {
  CLI::App* params = app.add_subcommand("params", "Parameter history of robots")->require_subcommand(1);
  const auto add = [&](const char* name, const char* help,
                       void (*function)(Context&, const ParameterArguments&)) {
    auto arguments = std::make_shared<ParameterArguments>();
    CLI::App* command = params->add_subcommand(name, help);
    command->add_option("--robot", arguments->robot, "Name; needed where several have parameters");
    command->callback([&context, arguments, function] { function(context, *arguments); });
    return std::pair{command, arguments};
  };
  auto [history, history_arguments] = add("history", "Every version, newest first", History);
  history->add_option("--limit", history_arguments->limit, "At most so many");
  history->add_option("--job", history_arguments->job, "Only what this job made");
  history->add_flag("--all", history_arguments->all, "Of every robot");
  auto [show, show_arguments] = add("show", "One version's values", Show);
  show->add_option("VERSION", show_arguments->version, "Default: the latest");
  auto [diff, diff_arguments] = add("diff", "What changed between two versions", Diff);
  diff->add_option("FROM", diff_arguments->version)->required()->check(CLI::Range(1u, 1'000'000'000u));
  diff->add_option("TO", diff_arguments->to, "Default: the latest");
  diff->add_option("--to-robot", diff_arguments->to_robot, "TO is a version of this robot instead");
  AddPromoteCommand(*params, context);
  AddPlotCommand(*params, context);
  AddExportCommand(*params, context);
}

}  // namespace rg::cli
