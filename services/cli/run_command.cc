// `realitygrad run`: the whole loop on this machine, through the real service.
#include <fcntl.h>
#include <sys/file.h>

#include <CLI/CLI.hpp>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <thread>

#include "common/base/file.h"
#include "common/base/ids.h"
#include "coordinator/client/client.h"
#include "realitygrad/v1/control.pb.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"
#include "services/cli/iteration_flags.h"
#include "services/cli/local_service.h"
#include "services/cli/model_source.h"
#include "services/cli/robot_profile.h"
#include "services/cli/ros_stand_in.h"
#include "services/cli/run_report.h"
#include "services/cli/run_state.h"

namespace rg::cli {
namespace {

namespace pb = ::realitygrad::v1;
namespace fs = std::filesystem;
using nlohmann::json;

struct RunArguments {
  RunState run;
  std::string parent = "realitygrad-runs", folder;
  bool resume = false, lock_step = false;
  int lock = -1;  // of the folder
};

// Whether the next rollout is excited: the first ones, and while a diagnosis says that there is a joint whose friction
// and inertia the rollouts so far cannot show.
bool TellTooLittle(const std::vector<json>& results) {
  if (static_cast<int>(results.size()) < jobs::kExcitedRollouts) return true;
  return !results.back().value("/diagnosis/quiet_joints"_json_pointer, json::array()).empty();
}

Status RunIteration(LocalService& service, const RobotProfile& profile, RunState* run, bool quiet) {
  jobs::IterationOptions options = run->options;
  options.iteration = static_cast<int>(run->results.size()) + 1;
  TakeProfile(profile, &options);
  jobs::IterationInputs inputs;
  if (run->results.empty()) {
    RG_ASSIGN_OR_RETURN(inputs.model, ChooseModel(service.client(), profile, "nominal"));
  } else {
    inputs.model = run->results.back().at("model").get<std::string>();
  }
  if (options.rollout.excitation < 0 && TellTooLittle(run->results))
    options.rollout.excitation = jobs::kLoopExcitation;
  if (options.diagnosis.on) {
    RG_ASSIGN_OR_RETURN(inputs.nominal, ChooseModel(service.client(), profile, "nominal"));
    for (const json& before : run->results) {
      inputs.identified = before.at("identified_model").get<std::string>();
      inputs.diagnosed = before.at("diagnosed_model").get<std::string>();
      inputs.earlier.push_back(before.at("rollout").at("sha256").get<std::string>());
    }
  }
  pb::JobSpec job = jobs::CompileIteration(options, inputs);
  job.set_submitted_by(UserAtHost());
  if (!quiet)
    PrintNote("iteration " + std::to_string(options.iteration) + " of " + std::to_string(run->iterations));
  // The id makes a repeat after --resume find the job that was under way.
  RG_ASSIGN_OR_RETURN(const pb::GetJobReply end,
                      RunJob(service.client(), std::move(job),
                             run->id + "-iteration-" + std::to_string(options.iteration), quiet));
  RG_ASSIGN_OR_RETURN(json result, FetchResult(service.client(), end));
  run->results.push_back(std::move(result));
  return SaveRun(*run);
}

// One process at a time goes on with a run: `lock` is its for as long as it lives.
Status TakeFolder(const std::string& folder, int* lock) {
  const std::string path = folder + "/.lock";
  *lock = ::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (*lock < 0) return InvalidError(path + ": cannot open: " + std::strerror(errno));
  if (::flock(*lock, LOCK_EX | LOCK_NB) == 0) return Status::Ok();
  return FailedPreconditionError(folder + ": this run is going on, in another `realitygrad run`");
}

Status MakeFolder(const RunArguments& arguments, RunState* run) {
  if (arguments.folder.empty()) {
    RG_ASSIGN_OR_RETURN(run->folder, NewRunFolder(arguments.parent));
    return Status::Ok();
  }
  if (fs::exists(arguments.folder + "/run.json")) {
    return AlreadyExistsError(arguments.folder +
                              " holds a run already; go on with it: realitygrad run --resume --dir " +
                              arguments.folder);
  }
  std::error_code error;
  fs::create_directories(arguments.folder + "/logs", error);
  if (error) return InvalidError(arguments.folder + ": cannot create: " + error.message());
  run->folder = arguments.folder;
  return Status::Ok();
}

std::string AgentConfigOf(const RobotProfile& profile, const RunState& run) {
  return profile.folder + "/" + profile.name + (run.stand_in ? "_kinova_agent.json" : "_agent.json");
}

std::string StandInConfigOf(const RobotProfile& profile) {
  return profile.folder + "/" + profile.name + "_stand_in.json";
}

Status CheckDriver(const Context& context, const RunArguments& arguments, const RobotProfile& profile) {
  const RunState& run = arguments.run;
  if (run.driver != "simulated" && run.driver != "kinova")
    return context.Usage(InvalidError("--driver is " + run.driver + ", must be simulated or kinova"));
  const bool kinova = run.driver == "kinova";
  if (kinova && !run.stand_in)
    return context.Usage(
        InvalidError("--driver kinova needs --stand-in: a real arm has an agent of its own beside it "
                     "(docs/kinova.md)"));
  if (run.stand_in && !kinova) return context.Usage(InvalidError("--stand-in needs --driver kinova"));
  if (!kinova) return Status::Ok();
  if (arguments.lock_step)
    return context.Usage(InvalidError("--lock-step is for the simulated robot: ROS runs in real time"));
  for (const std::string& file : {AgentConfigOf(profile, run), StandInConfigOf(profile)})
    if (!fs::exists(file))
      return InvalidError("robot '" + run.robot + "' has no stand-in: " + file + " is not there");
  return CheckRosStandIn();
}

// The folder is made last: what is refused leaves nothing.
Status Prepare(const Context& context, RunArguments* arguments, RobotProfile* profile) {
  RunState& run = arguments->run;
  if (arguments->resume) {
    if (arguments->folder.empty()) {
      RG_ASSIGN_OR_RETURN(arguments->folder, UnfinishedRunFolder(arguments->parent));
    }
    RG_ASSIGN_OR_RETURN(run, LoadRun(arguments->folder));
    RG_RETURN_IF_ERROR(TakeFolder(arguments->folder, &arguments->lock));
  }
  RG_ASSIGN_OR_RETURN(const Settings settings, context.Resolve());
  RG_ASSIGN_OR_RETURN(*profile, LoadRobotProfile(RobotsFolder(settings), run.robot));
  if (profile->truth.empty())
    return InvalidError("robot '" + run.robot +
                        "' has no simulated robot: 'truth' is missing in its profile");
  RG_RETURN_IF_ERROR(LoadRobot(*profile).status());
  RG_RETURN_IF_ERROR(CheckDriver(context, *arguments, *profile));
  if (run.iterations < 1)
    return context.Usage(
        InvalidError("--iterations is " + std::to_string(run.iterations) + ", must be at least 1"));
  jobs::IterationOptions options = run.options;
  TakeProfile(*profile, &options);
  RG_RETURN_IF_ERROR(context.Usage(jobs::Validate(options)));
  if (run.workers <= 0) run.workers = std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
  if (!arguments->resume) {
    run.id = "run-" + RandomHex(8);
    RG_RETURN_IF_ERROR(MakeFolder(*arguments, &run));
    RG_RETURN_IF_ERROR(TakeFolder(run.folder, &arguments->lock));
  }
  return SaveRun(run);
}

void PrintEnd(const Context& context, const RunState& run, const std::string& page) {
  if (context.json()) {
    json out = RunJson(run.results);
    out["folder"] = run.folder, out["report"] = page;
    return PrintJson("realitygrad.run-result/1", out);
  }
  if (context.quiet()) return Print(run.folder);
  Print(IterationsTable(run.results));
  if (const std::string said = ImpossibleText(run.results); !said.empty()) Print(said);
  if (const std::string said = RolloutsText(run.results); !said.empty()) Print(said);
  if (const std::string said = DiagnosesText(run.results); !said.empty()) Print(said);
  Print("page:      " + page);
  Print("next:      realitygrad --coordinator " + run.folder + " params history");
  Print("           realitygrad --coordinator " + run.folder + " artifacts list");
}

void Run(Context& context, RunArguments& arguments) {
  InstallInterruptHandlers();
  RobotProfile profile;
  if (context.Failed(Prepare(context, &arguments, &profile))) return;
  RunState& run = arguments.run;
  const bool quiet = context.quiet();
  Status status;
  {
    LocalService service;
    if (!quiet)
      PrintNote("run " + run.folder + ": coordinator, " + std::to_string(run.workers) +
                (run.stand_in ? " workers, a ROS master, the stand-in of a " + run.robot + " and its agent"
                              : " workers and the agent of a simulated " + run.robot));
    status = service.Start({.folder = run.folder,
                            .agent_config = AgentConfigOf(profile, run),
                            .workers = run.workers,
                            .lock_step = arguments.lock_step,
                            .stand_in = run.stand_in ? StandInConfigOf(profile) : "",
                            .seed = run.options.seed,
                            .quiet = quiet});
    if (status.ok() && !quiet)
      PrintNote("look in from another terminal: realitygrad --coordinator " + service.address() +
                " job show");
    while (status.ok() && static_cast<int>(run.results.size()) < run.iterations) {
      status = RunIteration(service, profile, &run, quiet);
      if (status.ok() && !quiet && static_cast<int>(run.results.size()) < run.iterations)
        PrintNote(IterationsTable(run.results));
      if (!status.ok() && !Interrupted()) {
        if (const Status child = service.Check(); !child.ok()) status = child;
      }
    }
  }
  if (Interrupted()) {
    PrintNote("stopped; nothing is lost. Go on with: realitygrad run --resume --dir " + run.folder);
    context.exit_code = kExitCancelled;
    return;
  }
  if (!status.ok()) {
    context.Failed(Status(status.code(), status.message() + "; logs: " + run.folder +
                                             "/logs; go on with: realitygrad run --resume --dir " + run.folder));
    if (status.code() == StatusCode::kAborted) context.exit_code = kExitJobFailed;
    return;
  }
  const std::string page = run.File("report.html");
  if (context.Failed(WriteFileAtomically(page, RunPage(run.robot, run.results)))) return;
  PrintEnd(context, run, page);
}

}  // namespace

void AddRunCommand(CLI::App& app, Context& context) {
  auto arguments = std::make_shared<RunArguments>();
  arguments->run.options.rollout.slower_attempts = jobs::kSlowerAttempts;  // its arms are simulated
  CLI::App* command = app.add_subcommand(
      "run", "The whole loop on this machine, with a simulated robot whose physics the model lacks");
  command->add_option("--iterations", arguments->run.iterations)->capture_default_str();
  command->add_option("--workers", arguments->run.workers, "Worker processes; default: one per core");
  command->add_option("--robot", arguments->run.robot, "Profile: a name, or a file")->capture_default_str();
  command->add_option("--seed", arguments->run.options.seed)->capture_default_str();
  command->add_option("--dir", arguments->folder,
                      "Folder of the run; default: the next number in " + arguments->parent);
  command->add_flag("--resume", arguments->resume,
                    "Go on with the run in --dir, or the newest unfinished one");
  command
      ->add_option("--driver", arguments->run.driver,
                   "How the agent reaches the arm: simulated or kinova (ROS 1)")
      ->capture_default_str();
  command->add_flag("--stand-in", arguments->run.stand_in,
                    "With --driver kinova: start a ROS master and a stand-in for kinova-ros and its arm");
  command->add_flag("--lock-step", arguments->lock_step, "The simulated robot does not wait for real time");
  AddTrajectoryFlags(command, &arguments->run.options);
  AddTrainFlags(command, &arguments->run.options);
  AddLearningFlags(command, &arguments->run.options);
  AddRolloutFlags(command, &arguments->run.options);
  AddLoopDiagnosisFlags(command, &arguments->run.options);
  AddIdentifyFlags(command, &arguments->run.options);
  AddPartialFlag(command, &arguments->run.options);
  command->callback([&context, arguments] { Run(context, *arguments); });
}

}  // namespace rg::cli
