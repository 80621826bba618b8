// `bench`: the project's figures on this machine.
#include <stdlib.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/model/robot_model.h"
#include "services/bench/bench.h"
#include "services/bench/scaling.h"
#include "services/cli/child_processes.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"
#include "services/cli/interrupt.h"
#include "services/cli/model_source.h"
#include "services/cli/progress_display.h"
#include "services/cli/robot_profile.h"
#include "services/cli/service_bench.h"
#include "services/cli/simulated_workers.h"
#include "services/report/page.h"

namespace rg::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

struct BenchArguments {
  bench::BenchOptions options;
  std::string robot = "mico2";
  std::string scaling;  // file for the plot; empty: the table
};

std::string LoadAverage() {
  double load[1] = {0};
  if (getloadavg(load, 1) != 1) return "unknown";
  return report::FormatNumber(load[0]);
}

// Seconds of the iteration of a `realitygrad run` at its defaults, the paper's size, in a folder of its own.
Result<double> RunIteration(const std::string& robot, const std::string& robots_folder, int workers) {
  char folder[] = "/tmp/realitygrad-bench-XXXXXX";
  if (mkdtemp(folder) == nullptr) return InternalError("/tmp: cannot make a folder");
  const std::string run = std::string(folder) + "/run";
  ChildProcesses children;
  RG_RETURN_IF_ERROR(
      children.Start("run",
                     {SiblingProgram("realitygrad"), "--robots", robots_folder, "run", "--iterations", "1",
                      "--workers", std::to_string(workers), "--robot", robot, "--dir", run},
                     std::string(folder) + "/run.log"));
  Result<double> seconds = CancelledError("interrupted");
  const CancelToken& interrupted = CancelledByInterrupt({SIGINT, SIGTERM});
  while (!interrupted.cancelled()) {
    const Status child = children.Check();  // an end, good or bad, is reported as an error
    const auto text = ReadFile(run + "/run.json");
    const json state = text.ok() ? json::parse(*text, nullptr, false) : json();
    if (state.is_object() && !state.value("results", json::array()).empty()) {
      seconds = state.at("results").at(0).at("seconds").at("iteration").get<double>();
      break;
    }
    if (!child.ok()) {
      seconds = child;
      break;
    }
    usleep(200'000);
  }
  children.StopAll(5.0);
  std::error_code error;
  if (seconds.ok()) fs::remove_all(folder, error);
  return seconds;
}

std::string BenchTable(const std::vector<bench::Measurement>& measurements) {
  TextTable table({"FIGURE", ">MEASURED", ">AT MOST", "UNIT", "RIVALS", "KEY"});
  for (const bench::Measurement& m : measurements) {
    for (const bench::Row& row : bench::Rows()) {
      if (m.key != row.key) continue;
      table.AddRow({quick ? row.quick : row.what, m.value ? report::FormatNumber(*m.value) : "–",
                    report::FormatNumber(row.target), row.unit, row.rival, row.key});
    }
  }
  std::string text = table.ToString();
  for (const bench::Measurement& m : measurements) text += m.key + ": " + m.note + "\n";
  return text;
}

// How the Jacobian's cost grows, as a plot and a table.
Status RunScaling(Context& context, const BenchArguments& arguments,
                  std::shared_ptr<const model::RobotModel> robot) {
  ProgressDisplay display(
      {.terminal = StderrIsTerminal(), .width = TerminalWidth(), .quiet = context.quiet()}, RealClock());
  RG_ASSIGN_OR_RETURN(
      const bench::Scaling scaling,
      bench::MeasureScaling(
          std::move(robot), arguments.options.quick, arguments.options.seed,
          [&](const ProgressUpdate& u) { display.Show(u); }, &CancelledByInterrupt({SIGINT, SIGTERM})));
  display.Finish();
  RG_RETURN_IF_ERROR(WriteFileAtomically(arguments.scaling, bench::ScalingSvg(scaling)));
  if (context.json()) {
    PrintJson("realitygrad.bench_scaling/1", bench::ScalingJson(scaling));
    return Status::Ok();
  }
  if (context.quiet()) return Status::Ok();
  const auto print = [](const char* head, const std::vector<bench::ScalingPoint>& points) {
    TextTable table({head, ">JACOBIAN, ms", ">LINE, ms"});
    const bench::ScalingLine line = bench::LineThrough(points);
    for (const bench::ScalingPoint& p : points) {
      table.AddRow({report::FormatNumber(p.x), report::FormatNumber(p.ms),
                    report::FormatNumber(line.at_zero + line.slope * p.x)});
    }
    Print(table.ToString());
  };
  print("SECONDS", scaling.by_length);
  print("PARAMETERS", scaling.by_parameters);
  Print("plot in " + arguments.scaling);
  return Status::Ok();
}

Status RunBenchCommand(Context& context, BenchArguments arguments) {
  RG_ASSIGN_OR_RETURN(const Settings settings, context.Resolve());
  RG_ASSIGN_OR_RETURN(const RobotProfile profile, LoadRobotProfile(RobotsFolder(settings), arguments.robot));
  RG_ASSIGN_OR_RETURN(const auto robot, LoadRobot(profile));
  if (!arguments.scaling.empty()) return RunScaling(context, arguments, robot);
  const std::string robots = RobotsFolder(settings);
  arguments.options.run_iteration = [&] {
    return RunIteration(arguments.robot, robots, arguments.options.threads);
  };
  ProgressDisplay display(
      {.terminal = StderrIsTerminal(), .width = TerminalWidth(), .quiet = context.quiet()}, RealClock());
  const std::string load_before = LoadAverage();
  RG_ASSIGN_OR_RETURN(const auto measurements, bench::RunBench(
                                                   robot, arguments.options, RealClock(),
                                                   [&](const ProgressUpdate& u) { display.Show(u); },
                                                   &CancelledByInterrupt({SIGINT, SIGTERM})));
  display.Finish();
  if (context.json()) {
    json out = bench::BenchJson(measurements);
    out["load_average"] = {{"before", load_before}, {"after", LoadAverage()}};
    PrintJson("realitygrad.bench/1", out);
    return Status::Ok();
  }
  if (context.quiet()) return Status::Ok();
  Print(BenchTable(measurements));
  Print("load average " + load_before + " before, " + LoadAverage() +
        " after. Rivals were measured on another machine; see tests/benchmarks for a yardstick in the same "
        "run.");
  return Status::Ok();
}

json ServiceBenchJson(const std::vector<bench::Measurement>& measurements) {
  json out, notes, samples, targets;
  for (const bench::Measurement& m : measurements) {
    out[m.key] = m.value ? json(*m.value) : json(nullptr);
    notes[m.key] = m.note;
    samples[m.key] = m.samples;
    for (const ServiceRow& row : ServiceRows()) {
      if (m.key == row.key) targets[m.key] = {{row.at_least ? "at_least" : "at_most", row.target}};
    }
  }
  out["notes"] = notes, out["samples"] = samples, out["targets"] = targets;
  return out;
}

std::string ServiceBenchTable(const std::vector<bench::Measurement>& measurements, bool quick) {
  TextTable table({"FIGURE", ">MEASURED", ">TARGET", "UNIT", "KEY"});
  std::string notes;
  for (const bench::Measurement& m : measurements) {
    for (const ServiceRow& row : ServiceRows()) {
      if (m.key != row.key) continue;
      table.AddRow({quick ? row.quick : row.what, m.value ? report::FormatNumber(*m.value) : "–",
                    (row.at_least ? "≥ " : "≤ ") + report::FormatNumber(row.target), row.unit, row.key});
    }
    notes += m.key + ": " + m.note + "\n";
  }
  return table.ToString() + notes;
}

Status RunServiceBenchCommand(Context& context, const ServiceBenchOptions& options) {
  ProgressDisplay display(
      {.terminal = StderrIsTerminal(), .width = TerminalWidth(), .quiet = context.quiet()}, RealClock());
  const std::string load_before = LoadAverage();
  RG_ASSIGN_OR_RETURN(const auto measurements, RunServiceBench(
                                                   options, [&](const ProgressUpdate& u) { display.Show(u); },
                                                   &CancelledByInterrupt({SIGINT, SIGTERM})));
  display.Finish();
  if (context.json()) {
    json out = ServiceBenchJson(measurements);
    out["load_average"] = {{"before", load_before}, {"after", LoadAverage()}};
    PrintJson("realitygrad.bench_service/1", out);
  } else if (!context.quiet()) {
    Print(ServiceBenchTable(measurements, options.quick));
    Print("load average " + load_before + " before, " + LoadAverage() + " after.");
  }
  return Status::Ok();
}

void AddServiceBench(CLI::App* bench, Context& context) {
  auto options = std::make_shared<ServiceBenchOptions>();
  CLI::App* service = bench->add_subcommand(
      "service", "The service on this machine: tasks per second, dispatch, restart, workers, artefacts");
  service->add_option("--only", options->only, "Keys, separated by commas")->delimiter(',');
  service->add_flag("--quick", options->quick, "Smaller loads");
  service->add_option("--workers", options->workers, "Of the row `workers`")
      ->check(CLI::Range(2, 5'000))
      ->capture_default_str();
  service->callback([&context, options] {
    context.Failed(RunServiceBenchCommand(context, *options));
    if (CancelledByInterrupt({SIGINT, SIGTERM}).cancelled()) context.exit_code = kExitCancelled;
  });
  auto workers = std::make_shared<SimulatedWorkersOptions>();
  CLI::App* simulated = bench->add_subcommand("simulated-workers", "What `bench service` starts")->group("");
  simulated->add_option("--coordinator", workers->coordinator)->required();
  simulated->add_option("--key", workers->key_file);
  simulated->add_option("--server-key", workers->server_key_file);
  simulated->add_option("--prefix", workers->prefix);
  simulated->add_option("--count", workers->count);
  simulated->add_option("--slots", workers->slots);
  simulated->add_option("--seconds", workers->seconds);
  simulated->add_option("--summary-bytes", workers->summary_bytes);
  simulated->add_option("--output-bytes", workers->output_bytes);
  simulated->add_option("--delays", workers->delays_file);
  simulated->callback([&context, workers] {
    context.Failed(RunSimulatedWorkers(*workers, CancelledByInterrupt({SIGINT, SIGTERM})));
  });
}

}  // namespace

void AddBenchCommand(CLI::App& app, Context& context) {
  auto arguments = std::make_shared<BenchArguments>();
  CLI::App* command =
      app.add_subcommand("bench", "Measure this machine: the project's figures beside rivals'");
  CLI::Option* only =
      command->add_option("--only", arguments->options.only, "Keys, separated by commas")->delimiter(',');
  command->add_flag("--quick", arguments->options.quick, "Fewer samples, no whole iteration");
  command->add_option("--threads", arguments->options.threads, "Of the rows that use several")
      ->check(CLI::Range(1, 1024))
      ->capture_default_str();
  command->add_option("--robot", arguments->robot, "Profile: a name, or a file")->capture_default_str();
  command->add_option("--seed", arguments->options.seed)->capture_default_str();
  command
      ->add_option("--scaling", arguments->scaling,
                   "Instead: how a Jacobian's cost grows with length and parameters; the plot's file (SVG)")
      ->excludes(only);
  AddServiceBench(command, context);
  command->callback([&context, arguments, command] {
    if (!command->get_subcommands().empty()) return;
    context.Failed(RunBenchCommand(context, *arguments));
    if (CancelledByInterrupt({SIGINT, SIGTERM}).cancelled()) context.exit_code = kExitCancelled;
  });
}

}  // namespace rg::cli
