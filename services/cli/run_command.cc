// `realitygrad run`: the whole loop on this machine, through the real service.
#include <signal.h>
#include <stdlib.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <thread>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/ids.h"
#include "coordinator/client/client.h"
#include "realitygrad/v1/control.pb.h"
#include "services/cli/child_processes.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"
#include "services/cli/iteration_flags.h"
#include "services/cli/job_view.h"
#include "services/cli/model_source.h"
#include "services/cli/robot_profile.h"
#include "services/cli/run_report.h"
#include "services/cli/run_state.h"
#include "services/jobs/kinds.h"

namespace rg::cli {
namespace {

namespace pb = ::realitygrad::v1;
namespace fs = std::filesystem;
using nlohmann::json;

struct RunArguments {
  RunState run;
  std::string parent = "realitygrad-runs", folder;
  bool resume = false, lock_step = false;
};

// Ctrl-C: the call under way returns, the loop ends, children are stopped; nothing is lost.
std::atomic<coordinator::Client*> interrupted_client{nullptr};
std::atomic<bool> interrupted{false};
void OnInterrupt(int) {
  interrupted = true;
  if (auto* client = interrupted_client.load()) client->Cancel();
}

// The service of a run: programs of this build on a socket in a folder that only this user can enter.
class LocalService {
 public:
  Status Start(const RunState& run, const RobotProfile& profile, bool lock_step);
  coordinator::Client& client() { return *client_; }
  const std::string& address() const { return address_; }
  Status Check() { return children_.Check(); }
  ~LocalService() {
    interrupted_client = nullptr;
    children_.StopAll(5.0);
    std::error_code error;
    if (!address_file_.empty()) fs::remove(address_file_, error);
    if (!socket_folder_.empty()) fs::remove_all(socket_folder_, error);
  }

 private:
  Status StartPrograms(const RunState& run, const RobotProfile& profile, bool lock_step);
  Status AwaitWorkers(size_t count);

  ChildProcesses children_;
  std::unique_ptr<coordinator::Client> client_;
  std::string address_, socket_folder_, address_file_;
};

Status LocalService::StartPrograms(const RunState& run, const RobotProfile& profile, bool lock_step) {
  RG_RETURN_IF_ERROR(children_.Start(
      "coordinator",
      {SiblingProgram("realitygrad-coordinator"), "--listen", address_, "--db", run.File("realitygrad.db")},
      run.File("logs/coordinator.log")));
  for (int w = 1; w <= run.workers; ++w) {
    const std::string name = "worker-" + std::to_string(w);
    RG_RETURN_IF_ERROR(
        children_.Start(name,
                        {SiblingProgram("realitygrad-worker"), "--coordinator", address_, "--name", name,
                         "--slots", "1", "--folder", run.File("cache/" + name)},
                        run.File("logs/" + name + ".log")));
  }
  std::vector<std::string> agent = {SiblingProgram("realitygrad-agent"),
                                    "--coordinator",
                                    address_,
                                    "--config",
                                    profile.folder + "/" + profile.name + "_agent.json",
                                    "--spool",
                                    run.File("spool"),
                                    "--folder",
                                    run.File("cache/agent")};
  if (lock_step) agent.push_back("--lock-step");
  return children_.Start("agent", agent, run.File("logs/agent.log"));
}

Status LocalService::AwaitWorkers(size_t count) {
  const double deadline = RealClock().SteadySeconds() + 20.0;
  size_t seen = 0;
  while (RealClock().SteadySeconds() < deadline && !interrupted) {
    RG_RETURN_IF_ERROR(children_.Check());
    const auto workers = client_->Workers();
    seen = 0;
    if (workers.ok()) {
      for (const auto& worker : *workers) seen += worker.connected();
      if (seen >= count) return Status::Ok();
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
  if (interrupted) return CancelledError("interrupted");
  return UnavailableError("only " + std::to_string(seen) + " of " + std::to_string(count) +
                          " programs joined the coordinator within 20 s");
}

Status LocalService::Start(const RunState& run, const RobotProfile& profile, bool lock_step) {
  char folder[] = "/tmp/realitygrad-XXXXXX";
  if (mkdtemp(folder) == nullptr) return InternalError("/tmp: cannot make a folder for the socket");
  socket_folder_ = folder;
  address_ = "ipc://" + socket_folder_ + "/coordinator.sock";
  RG_RETURN_IF_ERROR(StartPrograms(run, profile, lock_step));
  coordinator::ClientOptions options;
  options.address = address_;
  RG_ASSIGN_OR_RETURN(client_, coordinator::Client::Connect(options));
  interrupted_client = client_.get();
  address_file_ = run.File("address");  // other commands find the coordinator through it
  RG_RETURN_IF_ERROR(WriteFileAtomically(address_file_, address_));
  return AwaitWorkers(static_cast<size_t>(run.workers) + 1);
}

// Seconds between the first start and the last end of a stage (and its numbered rounds).
double StageSeconds(const pb::GetJobReply& job, const std::string& stage) {
  int64_t start = 0, end = 0;
  for (const pb::StageInfo& s : job.stages()) {
    if (s.name().rfind(stage, 0) != 0 || s.started_ns() == 0) continue;
    start = start == 0 ? s.started_ns() : std::min(start, s.started_ns());
    end = std::max(end, s.finished_ns());
  }
  return end > start ? 1e-9 * static_cast<double>(end - start) : std::nan("");
}

const pb::TaskOutput* FindOutput(const pb::GetJobReply& job, const std::string& kind) {
  for (const pb::TaskInfo& task : job.tasks()) {
    for (const pb::TaskOutput& output : task.outputs()) {
      if (output.kind() == kind) return &output;
    }
  }
  return nullptr;
}

Result<json> FetchResult(coordinator::Client& client, const pb::GetJobReply& job) {
  const pb::TaskOutput* output = FindOutput(job, jobs::kArtifactResult);
  const pb::TaskOutput* model = FindOutput(job, jobs::kArtifactModel);
  if (output == nullptr || model == nullptr)
    return InternalError("job " + std::to_string(job.job().id()) + " left no result");
  RG_ASSIGN_OR_RETURN(const std::string bytes, client.GetArtifact(output->sha256()));
  json result = json::parse(bytes, nullptr, false);
  if (!result.is_object())
    return DataLossError("the result of job " + std::to_string(job.job().id()) + " is no JSON");
  for (const std::string& stage : jobs::IterationStages())
    result["seconds"][stage] = StageSeconds(job, stage);
  result["seconds"]["iteration"] =
      1e-9 * static_cast<double>(job.job().finished_ns() - job.job().started_ns());
  result["job"] = job.job().id();
  result["model"] = model->sha256();
  return result;
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
  pb::JobSpec job = jobs::CompileIteration(options, inputs);
  job.set_submitted_by("run");
  // The id makes a repeat after --resume find the job that was under way.
  RG_ASSIGN_OR_RETURN(const int64_t id, service.client().Submit(job, run->id + "-iteration-" +
                                                                         std::to_string(options.iteration)));
  if (!quiet)
    PrintNote("iteration " + std::to_string(options.iteration) + " of " + std::to_string(run->iterations) +
              ": job " + std::to_string(id));
  RG_ASSIGN_OR_RETURN(const pb::GetJobReply progress, FollowJob(service.client(), id, -1, quiet));
  if (progress.job().state() == pb::JOB_STATE_CANCELLED)
    return CancelledError("job " + std::to_string(id) + " was cancelled");
  if (progress.job().state() != pb::JOB_STATE_SUCCEEDED) {
    return AbortedError("job " + std::to_string(id) + " failed: " + progress.job().reason());
  }
  RG_ASSIGN_OR_RETURN(const pb::GetJobReply end, service.client().GetJob(id, true, false));
  RG_ASSIGN_OR_RETURN(json result, FetchResult(service.client(), end));
  run->results.push_back(std::move(result));
  return SaveRun(*run);
}

Status Prepare(const Context& context, RunArguments* arguments, RobotProfile* profile) {
  RunState& run = arguments->run;
  if (arguments->resume) {
    if (arguments->folder.empty()) {
      RG_ASSIGN_OR_RETURN(arguments->folder, UnfinishedRunFolder(arguments->parent));
    }
    RG_ASSIGN_OR_RETURN(run, LoadRun(arguments->folder));
  } else if (!arguments->folder.empty()) {
    if (fs::exists(arguments->folder + "/run.json")) {
      return AlreadyExistsError(arguments->folder +
                                " holds a run already; go on with it: realitygrad run --resume --dir " +
                                arguments->folder);
    }
    std::error_code error;
    fs::create_directories(arguments->folder + "/logs", error);
    if (error) return InternalError(arguments->folder + ": cannot create: " + error.message());
    run.folder = arguments->folder;
  } else {
    RG_ASSIGN_OR_RETURN(run.folder, NewRunFolder(arguments->parent));
  }
  RG_ASSIGN_OR_RETURN(const Settings settings, context.Resolve());
  RG_ASSIGN_OR_RETURN(*profile, LoadRobotProfile(RobotsFolder(settings), run.robot));
  if (profile->truth.empty())
    return InvalidError("robot '" + run.robot +
                        "' has no simulated robot: 'truth' is missing in its profile");
  RG_RETURN_IF_ERROR(LoadRobot(*profile).status());
  if (run.iterations < 1)
    return InvalidError("--iterations is " + std::to_string(run.iterations) + ", must be at least 1");
  RG_RETURN_IF_ERROR(jobs::Validate(run.options));
  if (run.workers <= 0) run.workers = std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
  if (!arguments->resume) run.id = "run-" + RandomHex(8);
  return SaveRun(run);
}

void InstallHandlers() {
  struct sigaction action {};
  action.sa_handler = OnInterrupt;
  sigemptyset(&action.sa_mask);
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
}

void PrintEnd(const Context& context, const RunState& run, const std::string& page) {
  if (context.json()) {
    json out = RunJson(run.results);
    out["folder"] = run.folder, out["report"] = page;
    return PrintJson("realitygrad.run-result/1", out);
  }
  if (context.quiet()) return Print(run.folder);
  Print(IterationsTable(run.results));
  Print("page:      " + page);
  Print("next:      realitygrad --coordinator " + run.folder + " params history");
  Print("           realitygrad --coordinator " + run.folder + " artifacts list");
}

void Run(Context& context, RunArguments& arguments) {
  InstallHandlers();
  RobotProfile profile;
  if (context.Failed(Prepare(context, &arguments, &profile))) return;
  RunState& run = arguments.run;
  const bool quiet = context.quiet();
  Status status;
  {
    LocalService service;
    if (!quiet)
      PrintNote("run " + run.folder + ": coordinator, " + std::to_string(run.workers) +
                " workers and the agent of a simulated " + run.robot);
    status = service.Start(run, profile, arguments.lock_step);
    if (status.ok() && !quiet)
      PrintNote("look in from another terminal: realitygrad --coordinator " + service.address() +
                " job show");
    while (status.ok() && static_cast<int>(run.results.size()) < run.iterations) {
      status = RunIteration(service, profile, &run, quiet);
      if (!status.ok() && !interrupted) {
        if (const Status child = service.Check(); !child.ok()) status = child;
      }
    }
  }
  if (interrupted) {
    PrintNote("stopped; nothing is lost. Go on with: realitygrad run --resume --dir " + run.folder);
    context.exit_code = kExitCancelled;
    return;
  }
  if (!status.ok()) {
    context.Failed(status);
    PrintNote("logs: " + run.folder + "/logs; try again with: realitygrad run --resume --dir " + run.folder);
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
  command->add_flag("--lock-step", arguments->lock_step, "The simulated robot does not wait for real time");
  AddTrajectoryFlags(command, &arguments->run.options);
  AddTrainFlags(command, &arguments->run.options);
  AddRolloutFlags(command, &arguments->run.options);
  AddIdentifyFlags(command, &arguments->run.options);
  command->callback([&context, arguments] { Run(context, *arguments); });
}

}  // namespace rg::cli
