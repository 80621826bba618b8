// `experiment bounded-vs-unbounded` and `experiment two-iterations`: the paper's experiments again, through
// the service that `run` starts, against a simulated robot whose physics the model lacks.
#include <CLI/CLI.hpp>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "common/base/ids.h"
#include "common/base/printf.h"
#include "common/model/robot_model.h"
#include "coordinator/client/client.h"
#include "realitygrad/v1/artifact.pb.h"
#include "realitygrad/v1/control.pb.h"
#include "services/cli/context.h"
#include "services/cli/iteration_flags.h"
#include "services/cli/local_service.h"
#include "services/cli/model_source.h"
#include "services/cli/robot_profile.h"
#include "services/cli/run_state.h"
#include "services/jobs/job_graphs.h"
#include "services/jobs/kinds.h"
#include "services/lab/experiment_report.h"
#include "services/lab/lab_commands.h"

namespace rg::lab {
namespace {

namespace pb = ::realitygrad::v1;
namespace fs = std::filesystem;
using nlohmann::json;

struct ExperimentArguments {
  Experiment experiment = Experiment::kBoundedVsUnbounded;
  std::string robot = "mico2", parent = "realitygrad-experiments", folder;
  int repetitions = 5, workers = 2;
  double budget_s = 60;
  double whole_window_s = 4;  // of the windows when the whole recording is fitted
  bool full = false, lock_step = false;
  jobs::IterationOptions options;
};

// The paper's setting (PAPER.md) but for the time of the search.
jobs::IterationOptions PaperOptions(Experiment experiment) {
  jobs::IterationOptions o;
  o.identify.whole_recording = false;  // one window of 0.2 s
  o.identify.rounds = 1;
  o.identify.parametrisation = "raw";
  o.identify.alpha = 1e-2;
  o.rollout.accept_partial = true;  // its length stands in the table
  if (experiment == Experiment::kBoundedVsUnbounded) {
    o.rollout.controller = "mpc";
    o.rollout.duration_s = 8.0;
    o.rollout.goal_position = {0.40, 0.48, 0.11};
    o.identify.alpha = 0.0;  // without the second term
  }
  return o;
}

class ExperimentRun {
 public:
  ExperimentRun(ExperimentArguments arguments, cli::RobotProfile profile, bool quiet)
      : arguments_(std::move(arguments)), profile_(std::move(profile)), quiet_(quiet) {}

  Status Run();
  const std::vector<json>& repetitions() const { return repetitions_; }
  const std::string& folder() const { return arguments_.folder; }
  std::string Setting() const;

 private:
  Status OpenFolder();
  Status Save() const;
  Result<json> Repeat(int repetition);
  Result<json> RepeatBounded(const jobs::IterationOptions& options, const std::string& request);
  Result<json> RepeatIterations(jobs::IterationOptions options, const std::string& request);
  Result<json> Identify(const jobs::IterationOptions& options, const jobs::IterationInputs& inputs,
                        const std::string& request);

  ExperimentArguments arguments_;
  cli::RobotProfile profile_;
  bool quiet_;
  std::string id_, nominal_;
  std::vector<json> repetitions_;
  std::unique_ptr<cli::LocalService> service_;
};

std::string ExperimentRun::Setting() const {
  return Printf("simulated %s with hidden physics, %d repetitions, search %.0f s on %d workers",
                arguments_.robot.c_str(), static_cast<int>(repetitions_.size()),
                arguments_.options.identify.budget_s, arguments_.workers);
}

// A folder that holds this experiment already is gone on with: its jobs are found by their request ids.
Status ExperimentRun::OpenFolder() {
  if (arguments_.folder.empty()) {
    RG_ASSIGN_OR_RETURN(arguments_.folder, cli::NewRunFolder(arguments_.parent));
  }
  std::error_code error;
  fs::create_directories(arguments_.folder, error);
  if (error) return InternalError(arguments_.folder + ": cannot create: " + error.message());
  id_ = "experiment-" + RandomHex(8);
  const auto text = ReadFile(arguments_.folder + "/experiment.json");
  if (!text.ok()) return Save();
  const json before = json::parse(*text, nullptr, false);
  if (!before.is_object() || before.value("experiment", "") != ExperimentName(arguments_.experiment))
    return AlreadyExistsError(arguments_.folder + " holds something else than the experiment " +
                              ExperimentName(arguments_.experiment));
  id_ = before.value("id", id_);
  repetitions_ = before.value("repetitions", std::vector<json>());
  return Status::Ok();
}

Status ExperimentRun::Save() const {
  const json file = {{"format", "realitygrad.experiment-state/1"},
                     {"experiment", ExperimentName(arguments_.experiment)},
                     {"id", id_},
                     {"setting", Setting()},
                     {"repetitions", repetitions_}};
  return WriteFileAtomically(arguments_.folder + "/experiment.json", file.dump());
}

Result<json> ExperimentRun::Identify(const jobs::IterationOptions& options,
                                     const jobs::IterationInputs& inputs, const std::string& request) {
  RG_ASSIGN_OR_RETURN(
      const pb::GetJobReply job,
      cli::RunJob(service_->client(), jobs::CompileIdentify(options, inputs), request, quiet_));
  return cli::FetchResult(service_->client(), job);
}

// MPC with nominal parameters, run live by the agent and recorded; both solvers on the same window; and
// what the loop does by itself, the whole recording.
Result<json> ExperimentRun::RepeatBounded(const jobs::IterationOptions& options, const std::string& request) {
  jobs::IterationInputs inputs;
  inputs.model = nominal_;
  RG_ASSIGN_OR_RETURN(
      const pb::GetJobReply rollout,
      cli::RunJob(service_->client(), jobs::CompileRollout(options, inputs), request + "-rollout", quiet_));
  const pb::TaskOutput* recording = cli::FindOutput(rollout, jobs::kArtifactRecording);
  if (recording == nullptr) return InternalError("the rollout left no recording");
  inputs.recording = recording->sha256();
  RG_ASSIGN_OR_RETURN(const pb::ArtifactInfo info, service_->client().ShowArtifact(inputs.recording));
  json out;
  out["rollout"] = json::parse(info.metadata_json(), nullptr, false);
  jobs::IterationOptions arm = options;
  arm.identify.solver = "lm", arm.identify.bounds = "paper";
  RG_ASSIGN_OR_RETURN(out["bounded"], Identify(arm, inputs, request + "-bounded"));
  arm.identify.solver = "lbfgs", arm.identify.bounds = "none";
  RG_ASSIGN_OR_RETURN(out["unbounded"], Identify(arm, inputs, request + "-unbounded"));
  arm.identify = jobs::IdentifyOptions();  // what `run` does
  arm.identify.budget_s = options.identify.budget_s, arm.identify.chains = options.identify.chains;
  arm.identify.window_s = arguments_.whole_window_s;
  RG_ASSIGN_OR_RETURN(out["whole"], Identify(arm, inputs, request + "-whole"));
  return out;
}

Result<json> ExperimentRun::RepeatIterations(jobs::IterationOptions options, const std::string& request) {
  jobs::IterationInputs inputs;
  inputs.model = nominal_;
  json out;
  for (int iteration = 1; iteration <= 2; ++iteration) {
    options.iteration = iteration;
    const std::string name = "iteration_" + std::to_string(iteration);
    RG_ASSIGN_OR_RETURN(const pb::GetJobReply job,
                        cli::RunJob(service_->client(), jobs::CompileIteration(options, inputs),
                                    request + "-" + name, quiet_));
    RG_ASSIGN_OR_RETURN(out[name], cli::FetchResult(service_->client(), job));
    inputs.model = out[name].at("model").get<std::string>();
  }
  return out;
}

Result<json> ExperimentRun::Repeat(int repetition) {
  jobs::IterationOptions options = arguments_.options;
  cli::TakeProfile(profile_, &options);
  options.seed += static_cast<uint64_t>(repetition);
  const std::string request = id_ + "-" + std::to_string(repetition + 1);
  return arguments_.experiment == Experiment::kTwoIterations ? RepeatIterations(options, request)
                                                             : RepeatBounded(options, request);
}

Status ExperimentRun::Run() {
  RG_RETURN_IF_ERROR(OpenFolder());
  service_ = std::make_unique<cli::LocalService>();
  RG_RETURN_IF_ERROR(service_->Start({.folder = arguments_.folder,
                                      .agent_config = profile_.folder + "/" + profile_.name + "_agent.json",
                                      .workers = arguments_.workers,
                                      .lock_step = arguments_.lock_step,
                                      .quiet = quiet_}));
  RG_ASSIGN_OR_RETURN(nominal_, cli::ChooseModel(service_->client(), profile_, "nominal"));
  while (static_cast<int>(repetitions_.size()) < arguments_.repetitions) {
    const int repetition = static_cast<int>(repetitions_.size());
    if (!quiet_)
      cli::PrintNote("repetition " + std::to_string(repetition + 1) + " of " +
                     std::to_string(arguments_.repetitions));
    auto result = Repeat(repetition);
    if (!result.ok()) {
      const Status child = cli::Interrupted() ? Status::Ok() : service_->Check();
      return child.ok() ? result.status() : child;
    }
    repetitions_.push_back(*std::move(result));
    RG_RETURN_IF_ERROR(Save());
  }
  return Status::Ok();
}

void PrintEnd(const cli::Context& context, Experiment experiment, const ExperimentRun& run,
              const std::string& page) {
  if (context.json())
    return cli::PrintJson("realitygrad.experiment/1",
                          {{"experiment", ExperimentName(experiment)},
                           {"setting", run.Setting()},
                           {"repetitions", run.repetitions().size()},
                           {"rows", ExperimentRows(experiment, run.repetitions())},
                           {"folder", run.folder()},
                           {"page", page}});
  if (context.quiet()) return cli::Print(page);
  cli::Print(run.Setting() + "; median [smallest … largest]");
  cli::Print(ExperimentTable(experiment, run.repetitions()));
  cli::Print("page:      " + page);
  cli::Print("next:      realitygrad --coordinator " + run.folder() + " params history");
}

Status RunExperiment(cli::Context& context, ExperimentArguments arguments) {
  cli::InstallInterruptHandlers();
  if (arguments.repetitions < 1)
    return InvalidError("--repetitions is " + std::to_string(arguments.repetitions) + ", must be at least 1");
  if (arguments.workers < 1)
    return InvalidError("--workers is " + std::to_string(arguments.workers) + ", must be at least 1");
  if (arguments.full) {
    const bool loop = arguments.experiment == Experiment::kTwoIterations;
    arguments.budget_s = loop ? 600 : 3600;
    arguments.workers = 6;
  }
  arguments.options.identify.budget_s = arguments.budget_s;
  arguments.options.identify.chains = arguments.workers;
  RG_RETURN_IF_ERROR(context.Usage(jobs::Validate(arguments.options)));
  RG_ASSIGN_OR_RETURN(const cli::Settings settings, context.Resolve());
  RG_ASSIGN_OR_RETURN(const cli::RobotProfile profile,
                      cli::LoadRobotProfile(cli::RobotsFolder(settings), arguments.robot));
  RG_ASSIGN_OR_RETURN(const auto robot, cli::LoadRobot(profile));
  ExperimentRun run(arguments, profile, context.quiet());
  const Status status = run.Run();
  if (!status.ok()) {
    if (!run.folder().empty())
      cli::PrintNote("go on with: realitygrad experiment " +
                     std::string(ExperimentName(arguments.experiment)) + " --dir " + run.folder() +
                     "; logs: " + run.folder() + "/logs");
    return status;
  }
  const std::string page = run.folder() + "/report.html";
  RG_RETURN_IF_ERROR(WriteFileAtomically(
      page, ExperimentPage(arguments.experiment, run.repetitions(), *robot, run.Setting())));
  PrintEnd(context, arguments.experiment, run, page);
  return Status::Ok();
}

void AddExperiment(CLI::App* parent, cli::Context& context, Experiment experiment, const char* help) {
  auto arguments = std::make_shared<ExperimentArguments>();
  arguments->experiment = experiment;
  arguments->options = PaperOptions(experiment);
  CLI::App* command = parent->add_subcommand(ExperimentName(experiment), help);
  command->add_option("--repetitions", arguments->repetitions)->capture_default_str();
  command->add_option("--budget", arguments->budget_s, "Seconds of each search")->capture_default_str();
  command->add_option("--workers", arguments->workers, "Worker processes, and chains of a search")
      ->capture_default_str();
  command->add_flag("--full", arguments->full,
                    "The paper's search: 60 min (in the loop 10 min) on 6 workers");
  command->add_option("--robot", arguments->robot, "Profile: a name, or a file")->capture_default_str();
  command->add_option("--seed", arguments->options.seed, "Of the first repetition")->capture_default_str();
  command->add_option("--dir", arguments->folder,
                      "Folder; one that holds this experiment is gone on with. Default: the next number in " +
                          arguments->parent);
  command->add_flag("--lock-step", arguments->lock_step, "The simulated robot does not wait for real time");
  command->add_option("--rollout-seconds", arguments->options.rollout.duration_s)->capture_default_str();
  command
      ->add_option("--window-start", arguments->options.identify.window_start_s,
                   "Of the 0.2 s that are fitted [s]")
      ->capture_default_str();
  if (experiment == Experiment::kBoundedVsUnbounded) {
    command
        ->add_option("--whole-window", arguments->whole_window_s,
                     "Length of the windows when the whole recording is fitted [s]")
        ->capture_default_str();
  } else {
    command->add_option("--window", arguments->options.identify.window_s,
                        "Length of the windows that are fitted [s]; 0: 0.2, of the whole recording as run");
    cli::AddTrajectoryFlags(command, &arguments->options);
    cli::AddTrainFlags(command, &arguments->options);
    command->add_flag_callback(
        "--whole-recording",
        [arguments] {
          arguments->options.identify.whole_recording = true;
          arguments->options.identify.alpha = jobs::IdentifyOptions().alpha;
        },
        "Fit all of the recording, not 0.2 s of it");
    command->add_option("--solver", arguments->options.identify.solver, "lm or lbfgs")->capture_default_str();
    command->add_option("--bounds", arguments->options.identify.bounds, "physical, paper (±20 %) or none")
        ->capture_default_str();
  }
  command->callback([&context, arguments] {
    context.Failed(RunExperiment(context, *arguments));
    if (cli::Interrupted()) context.exit_code = cli::kExitCancelled;
  });
}

}  // namespace

void AddExperimentCommand(CLI::App& app, cli::Context& context) {
  CLI::App* command =
      app.add_subcommand("experiment", "The paper's experiments again, beside the paper's figures")
          ->require_subcommand(1);
  AddExperiment(command, context, Experiment::kBoundedVsUnbounded,
                "One recording, both solvers: what bounds cost and save");
  AddExperiment(command, context, Experiment::kTwoIterations, "The loop, twice, five times over");
}

}  // namespace rg::lab
