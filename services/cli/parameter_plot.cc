// `params plot`: parameters and residuals over versions, of one robot or several, as a page.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <set>

#include "common/base/file.h"
#include "coordinator/client/client.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"
#include "services/report/page.h"

namespace rg::cli {
namespace {

namespace pb = ::realitygrad::v1;

struct PlotArguments {
  std::vector<std::string> names, robots, jobs;
  std::string html = "parameters.html";
  unsigned limit = 100;
};

struct RobotHistory {
  std::string robot;
  std::vector<pb::ParameterVersion> versions;  // oldest first, with values
};

Result<RobotHistory> Fetch(coordinator::Client& client, const std::string& robot,
                           const PlotArguments& arguments) {
  RobotHistory out{robot, {}};
  RG_ASSIGN_OR_RETURN(const auto versions, client.ParameterHistory(robot, arguments.limit));
  const std::set<std::string> jobs(arguments.jobs.begin(), arguments.jobs.end());
  for (auto version = versions.rbegin(); version != versions.rend(); ++version) {
    if (!jobs.empty() && jobs.count(version->job_id()) == 0) continue;
    RG_ASSIGN_OR_RETURN(auto full, client.Parameters(robot, version->version()));
    out.versions.push_back(std::move(full));
  }
  return out;
}

double ValueOf(const pb::ParameterVersion& version, const std::string& name) {
  for (const auto& value : version.values()) {
    if (value.name() == name) return value.value();
  }
  return std::nan("");
}

// Names that any version has, in the order of their first appearance; with `wanted` those that contain one of
// them.
std::vector<std::string> NamesOf(const std::vector<RobotHistory>& robots,
                                 const std::vector<std::string>& wanted) {
  std::vector<std::string> names;
  std::set<std::string> known;
  for (const RobotHistory& robot : robots) {
    for (const auto& version : robot.versions) {
      for (const auto& value : version.values()) {
        const bool is_wanted =
            wanted.empty() || std::any_of(wanted.begin(), wanted.end(), [&](const std::string& part) {
              return value.name().find(part) != std::string::npos;
            });
        if (is_wanted && known.insert(value.name()).second) names.push_back(value.name());
      }
    }
  }
  return names;
}

report::Plot ResidualPlot(const std::vector<RobotHistory>& robots) {
  report::Plot plot{.title = "Residual", .x_label = "version", .y_label = "residual"};
  for (const RobotHistory& robot : robots) {
    report::Series before{robot.robot + " before", {}, {}, report::SeriesStyle::kDashed};
    report::Series after{robot.robot + " after", {}, {}};
    for (const auto& v : robot.versions) {
      before.x.push_back(v.version()), after.x.push_back(v.version());
      before.y.push_back(v.has_residual_before() ? v.residual_before() : std::nan(""));
      after.y.push_back(v.has_residual_after() ? v.residual_after() : std::nan(""));
    }
    plot.series.push_back(before), plot.series.push_back(after);
  }
  return plot;
}

report::Plot ParameterPlot(const std::vector<RobotHistory>& robots, const std::string& name) {
  report::Plot plot{.title = name, .x_label = "version", .y_label = ""};
  for (const RobotHistory& robot : robots) {
    report::Series series{robot.robot, {}, {}};
    for (const auto& v : robot.versions)
      series.x.push_back(v.version()), series.y.push_back(ValueOf(v, name));
    plot.series.push_back(series);
  }
  return plot;
}

Status Plot(Context& context, const PlotArguments& arguments) {
  RG_ASSIGN_OR_RETURN(const auto client, context.Connect());
  std::vector<std::string> names = arguments.robots;
  if (names.empty()) {
    RG_ASSIGN_OR_RETURN(names, client->Robots());
  }
  std::vector<RobotHistory> robots;
  for (const std::string& name : names) {
    RG_ASSIGN_OR_RETURN(robots.emplace_back(), Fetch(*client, name, arguments));
    if (robots.back().versions.empty()) robots.pop_back();
  }
  const auto parameters = NamesOf(robots, arguments.names);
  if (parameters.empty())
    return NotFoundError("no such parameters: params history says which versions there are");
  std::string subtitle;
  for (const RobotHistory& robot : robots)
    subtitle += (subtitle.empty() ? "" : ", ") + robot.robot + " (" + std::to_string(robot.versions.size()) +
                " versions)";
  report::Page page("Parameters", subtitle);
  page.AddPlots({ResidualPlot(robots)}, 600);
  page.Heading("Values by version");
  std::vector<report::Plot> plots;
  for (const std::string& name : parameters) plots.push_back(ParameterPlot(robots, name));
  page.AddPlots(plots, 340);
  RG_RETURN_IF_ERROR(WriteFileAtomically(arguments.html, page.Html()));
  if (context.json()) {
    PrintJson("realitygrad.parameter-plot/1",
              {{"path", arguments.html}, {"parameters", parameters}, {"robots", names}});
  } else {
    Print(arguments.html);
  }
  return Status::Ok();
}

}  // namespace

void AddPlotCommand(CLI::App& params, Context& context) {
  auto arguments = std::make_shared<PlotArguments>();
  CLI::App* command =
      params.add_subcommand("plot", "Parameters and residuals by version, as a page; of several robots too");
  command->add_option("NAME", arguments->names, "Parts of parameters' names (default: all parameters)");
  command->add_option("--robot", arguments->robots, "These robots (default: all); several");
  command->add_option("--job", arguments->jobs, "Only what these jobs made; several");
  command->add_option("--limit", arguments->limit, "Of each robot the newest so many")->capture_default_str();
  command->add_option("--html", arguments->html, "File to write")->capture_default_str();
  command->callback([&context, arguments] { context.Failed(Plot(context, *arguments)); });
}

}  // namespace rg::cli
