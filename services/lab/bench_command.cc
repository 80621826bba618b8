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
#include "services/cli/child_processes.h"
#include "services/cli/context.h"
#include "services/cli/interrupt.h"
#include "services/cli/model_source.h"
#include "services/cli/progress_display.h"
#include "services/cli/robot_profile.h"
#include "services/lab/bench.h"
#include "services/lab/lab_commands.h"
#include "services/lab/scaling.h"
#include "services/lab/service_bench.h"
#include "services/lab/simulated_workers.h"
#include "services/report/page.h"

namespace rg::lab {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

struct BenchArguments {
  BenchOptions options;
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
  cli::ChildProcesses children;
  RG_RETURN_IF_ERROR(
      children.Start("run",
                     {cli::SiblingProgram("realitygrad"), "--robots", robots_folder, "run", "--iterations",
                      "1", "--workers", std::to_string(workers), "--robot", robot, "--dir", run},
                     std::string(folder) + "/run.log"));
  Result<double> seconds = CancelledError("interrupted");
  const CancelToken& interrupted = cli::CancelledByInterrupt({SIGINT, SIGTERM});
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

std::string BenchTable(const std::vector<Row>& rows, const std::vector<Measurement>& measurements) {
  cli::TextTable table({"FIGURE", ">MEASURED", ">TARGET", "UNIT", "RIVALS", "KEY"});
  std::string notes;
  for (const Measurement& m : measurements) {
    for (const Row& row : rows) {
      if (m.key != row.key) continue;
      table.AddRow({row.what, m.value ? report::FormatNumber(*m.value) : "–",
                    (row.at_least ? "≥ " : "≤ ") + report::FormatNumber(row.target), row.unit,
                    row.rival != nullptr ? row.rival : "–", row.key});
    }
    notes += m.key + ": " + m.note + "\n";
  }
  return table.ToString() + notes;
}

// `measure` with a display of its progress; as JSON or a table.
Status Tell(
    cli::Context& context, const std::string& format, const std::vector<Row>& rows,
    const std::function<Result<std::vector<Measurement>>(const ProgressFn&, const CancelToken*)>& measure) {
  cli::ProgressDisplay display(context.quiet());
  const std::string before = LoadAverage();
  RG_ASSIGN_OR_RETURN(const auto measurements, measure([&](const ProgressUpdate& u) { display.Show(u); },
                                                       &cli::CancelledByInterrupt({SIGINT, SIGTERM})));
  display.Finish();
  if (context.json()) {
    json out = BenchJson(rows, measurements);
    out["load_average"] = {{"before", before}, {"after", LoadAverage()}};
    cli::PrintJson(format, out);
  } else if (!context.quiet()) {
    cli::Print(BenchTable(rows, measurements));
    cli::Print("load average " + before + " before, " + LoadAverage() +
               " after. Rivals were measured on another machine (tests/benchmarks has a yardstick).");
  }
  return Status::Ok();
}

// How the Jacobian's cost grows, as a plot and a table.
Status RunScaling(cli::Context& context, const BenchArguments& arguments,
                  std::shared_ptr<const model::RobotModel> robot) {
  cli::ProgressDisplay display(context.quiet());
  RG_ASSIGN_OR_RETURN(
      const Scaling scaling,
      MeasureScaling(
          std::move(robot), arguments.options.quick, arguments.options.seed,
          [&](const ProgressUpdate& u) { display.Show(u); }, &cli::CancelledByInterrupt({SIGINT, SIGTERM})));
  display.Finish();
  RG_RETURN_IF_ERROR(WriteFileAtomically(arguments.scaling, ScalingSvg(scaling)));
  if (context.json()) {
    cli::PrintJson("realitygrad.bench_scaling/1", ScalingJson(scaling));
    return Status::Ok();
  }
  if (context.quiet()) return Status::Ok();
  const auto print = [](const char* head, const std::vector<ScalingPoint>& points) {
    cli::TextTable table({head, ">JACOBIAN, ms", ">LINE, ms"});
    const ScalingLine line = LineThrough(points);
    for (const ScalingPoint& p : points) {
      table.AddRow({report::FormatNumber(p.x), report::FormatNumber(p.ms),
                    report::FormatNumber(line.at_zero + line.slope * p.x)});
    }
    cli::Print(table.ToString());
  };
  print("SECONDS", scaling.by_length);
  print("PARAMETERS", scaling.by_parameters);
  cli::Print("plot in " + arguments.scaling);
  return Status::Ok();
}

Status RunBenchCommand(cli::Context& context, BenchArguments arguments) {
  RG_ASSIGN_OR_RETURN(const cli::Settings settings, context.Resolve());
  RG_ASSIGN_OR_RETURN(const cli::RobotProfile profile,
                      cli::LoadRobotProfile(cli::RobotsFolder(settings), arguments.robot));
  RG_ASSIGN_OR_RETURN(const auto robot, cli::LoadRobot(profile));
  if (!arguments.scaling.empty()) return RunScaling(context, arguments, robot);
  const std::string robots = cli::RobotsFolder(settings);
  arguments.options.run_iteration = [&] {
    return RunIteration(arguments.robot, robots, arguments.options.threads);
  };
  return Tell(context, "realitygrad.bench/1", Rows(),
              [&](const ProgressFn& progress, const CancelToken* cancel) {
                return RunBench(robot, arguments.options, RealClock(), progress, cancel);
              });
}

void AddServiceBench(CLI::App* bench, cli::Context& context) {
  auto options = std::make_shared<ServiceBenchOptions>();
  CLI::App* service = bench->add_subcommand(
      "service", "The service on this machine: tasks per second, dispatch, restart, workers, artefacts");
  service->add_option("--only", options->only, "Keys, separated by commas")->delimiter(',');
  service->add_flag("--quick", options->quick, "Smaller loads");
  service->add_option("--workers", options->workers, "Of the row `workers`")
      ->check(CLI::Range(2, 5'000))
      ->capture_default_str();
  service->callback([&context, options] {
    context.Failed(Tell(context, "realitygrad.bench_service/1", ServiceRows(options->quick),
                        [&](const ProgressFn& progress, const CancelToken* cancel) {
                          return RunServiceBench(*options, progress, cancel);
                        }));
    if (cli::CancelledByInterrupt({SIGINT, SIGTERM}).cancelled()) context.exit_code = cli::kExitCancelled;
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
    context.Failed(RunSimulatedWorkers(*workers, cli::CancelledByInterrupt({SIGINT, SIGTERM})));
  });
}

}  // namespace

void AddBenchCommand(CLI::App& app, cli::Context& context) {
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
    if (cli::CancelledByInterrupt({SIGINT, SIGTERM}).cancelled()) context.exit_code = cli::kExitCancelled;
  });
}

}  // namespace rg::lab
