#include <unistd.h>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "coordinator/client/client.h"
#include "realitygrad/v1/control.pb.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"
#include "services/cli/iteration_flags.h"
#include "services/cli/job_view.h"
#include "services/cli/model_source.h"
#include "services/cli/robot_profile.h"
#include "services/jobs/job_graphs.h"
#include "services/jobs/kinds.h"

namespace rg::cli {
namespace {

namespace pb = ::realitygrad::v1;
using nlohmann::json;

struct SubmitArguments {
  jobs::IterationOptions options;
  std::string robot = "mico2", model = "latest", policy, recording, name, request_id;
  std::vector<std::string> shards;
  int64_t shards_of_job = 0;
  int priority = 0;
  bool wait = false, follow = false, dry_run = false;
  double timeout_s = -1;
};

using Compile = pb::JobSpec (*)(const jobs::IterationOptions&, const jobs::IterationInputs&);

Result<std::vector<std::string>> FindShards(coordinator::Client& client, const SubmitArguments& arguments) {
  std::vector<std::string> shards;
  for (const std::string& named : arguments.shards) {
    RG_ASSIGN_OR_RETURN(std::string sha256, FindArtifact(client, named, jobs::kArtifactShard));
    shards.push_back(std::move(sha256));
  }
  if (!shards.empty()) return shards;
  int64_t job = arguments.shards_of_job;
  if (job == 0) {  // the newest job that made some
    RG_ASSIGN_OR_RETURN(const auto newest, client.ListArtifacts(jobs::kArtifactShard, 0, 1));
    if (newest.empty()) return NotFoundError("no trajectories yet: submit trajectories first");
    job = std::stoll(newest.front().job_id());
  }
  RG_ASSIGN_OR_RETURN(auto made, client.ListArtifacts(jobs::kArtifactShard, job, 0));
  if (made.empty()) return NotFoundError("job " + std::to_string(job) + " made no trajectories");
  for (const auto& info : made) shards.push_back(info.sha256());
  return shards;
}

Result<jobs::IterationInputs> FindInputs(coordinator::Client& client, const RobotProfile& profile,
                                         const std::string& what, const SubmitArguments& arguments) {
  jobs::IterationInputs inputs;
  RG_ASSIGN_OR_RETURN(inputs.model, ChooseModel(client, profile, arguments.model));
  if (what == "iteration" && arguments.options.diagnosis.on) {
    RG_ASSIGN_OR_RETURN(inputs.nominal, ChooseModel(client, profile, "nominal"));
  }
  if (what == "train") {
    RG_ASSIGN_OR_RETURN(inputs.shards, FindShards(client, arguments));
  }
  if (what == "rollout" && arguments.options.rollout.controller == "policy") {
    RG_ASSIGN_OR_RETURN(inputs.policy, FindArtifact(client, arguments.policy, jobs::kArtifactPolicy));
  }
  if (what == "identify") {
    RG_ASSIGN_OR_RETURN(inputs.recording,
                        FindArtifact(client, arguments.recording, jobs::kArtifactRecording));
  }
  return inputs;
}

std::string UserAtHost() {
  char host[256] = "?";
  gethostname(host, sizeof host - 1);
  const char* user = getenv("USER");
  return std::string(user ? user : "user") + "@" + host;
}

Status PrintGraph(Context& context, const pb::JobSpec& job) {
  std::map<std::string, int> stages;
  for (const auto& task : job.tasks()) ++stages[task.stage()];
  if (context.json()) {
    PrintJson("realitygrad.dry-run/1",
              {{"kind", job.kind()}, {"tasks", job.tasks_size()}, {"stages", stages}});
  } else {
    TextTable table({"STAGE", ">TASKS"});
    for (const auto& [stage, tasks] : stages) table.AddRow({stage, std::to_string(tasks)});
    Print("would submit " + job.kind() + " with " + std::to_string(job.tasks_size()) + " tasks\n" +
          table.ToString());
  }
  return Status::Ok();
}

Status Submit(Context& context, const std::string& what, Compile compile, SubmitArguments& arguments) {
  RG_ASSIGN_OR_RETURN(const Settings settings, context.Resolve());
  RG_ASSIGN_OR_RETURN(const RobotProfile profile, LoadRobotProfile(RobotsFolder(settings), arguments.robot));
  TakeProfile(profile, &arguments.options);
  RG_RETURN_IF_ERROR(context.Usage(jobs::Validate(arguments.options)));
  RG_ASSIGN_OR_RETURN(const auto client, context.Connect());
  RG_ASSIGN_OR_RETURN(const auto inputs, FindInputs(*client, profile, what, arguments));
  pb::JobSpec job = compile(arguments.options, inputs);
  job.set_submitted_by(UserAtHost());
  job.set_priority(arguments.priority);
  if (!arguments.name.empty()) job.set_name(arguments.name);
  if (arguments.dry_run) return PrintGraph(context, job);
  RG_ASSIGN_OR_RETURN(const int64_t id, client->Submit(job, arguments.request_id));
  if (!arguments.wait && !arguments.follow) {
    if (context.json()) {
      PrintJson("realitygrad.submitted/1", {{"job", id}});
    } else {
      Print(std::to_string(id));
      if (!context.quiet()) PrintNote("next: realitygrad job watch " + std::to_string(id));
    }
    return Status::Ok();
  }
  RG_ASSIGN_OR_RETURN(const auto end,
                      FollowJob(*client, id, arguments.timeout_s, context.quiet() || !arguments.follow));
  if (context.json()) {
    PrintJson("realitygrad.job/1", JobDetailsJson(end));
  } else {
    Print(context.quiet() ? std::to_string(id) : JobDetails(end, false));
  }
  context.exit_code = coordinator::ExitCodeOf(end.job().state());
  return Status::Ok();
}

}  // namespace

void AddSubmitCommands(CLI::App& app, Context& context) {
  CLI::App* submit = app.add_subcommand("submit", "Submit a job to the coordinator")->require_subcommand(1);
  const auto add = [&](const char* what, const char* help, Compile compile) {
    auto arguments = std::make_shared<SubmitArguments>();
    CLI::App* command = submit->add_subcommand(what, help);
    command->add_option("--robot", arguments->robot, "Profile: a name, or a file")->capture_default_str();
    command->add_option("--model", arguments->model, "latest, nominal, a model.json, or an artefact")
        ->capture_default_str();
    command->add_option("--seed", arguments->options.seed)->capture_default_str();
    command->add_option("--name", arguments->name, "For people");
    command->add_option("--priority", arguments->priority, "Higher first")->capture_default_str();
    command->add_option("--request-id", arguments->request_id, "The same id never makes a second job");
    command->add_flag("--wait", arguments->wait, "Until it ends; the exit code says how");
    command->add_flag("--follow", arguments->follow, "The same, with progress");
    command->add_option("--timeout", arguments->timeout_s, "Seconds to wait at the most");
    command->add_flag("--dry-run", arguments->dry_run, "Show what would be submitted");
    command->callback(
        [&context, arguments, what, compile] { context.Failed(Submit(context, what, compile, *arguments)); });
    return std::pair{command, arguments};
  };
  AddSubmitDiagnose(*submit, context);
  auto [iteration, ia] =
      add("iteration", "Trajectories, policy, rollout, identification", jobs::CompileIteration);
  AddTrajectoryFlags(iteration, &ia->options);
  AddTrainFlags(iteration, &ia->options);
  AddLearningFlags(iteration, &ia->options);
  AddRolloutFlags(iteration, &ia->options);
  AddLoopDiagnosisFlags(iteration, &ia->options);
  AddIdentifyFlags(iteration, &ia->options);
  auto [trajectories, ta] =
      add("trajectories", "Optimal trajectories between random poses", jobs::CompileTrajectories);
  AddTrajectoryFlags(trajectories, &ta->options);
  auto [train, tr] = add("train", "A policy from trajectories", jobs::CompileTrain);
  AddTrainFlags(train, &tr->options);
  train->add_option("--shards", tr->shards, "Artefacts; default: of --of-job")->delimiter(',');
  train->add_option("--of-job", tr->shards_of_job, "The job that made the trajectories; default: the newest");
  auto [rollout, ra] = add("rollout", "A policy on the robot, recorded", jobs::CompileRollout);
  AddRolloutFlags(rollout, &ra->options);
  rollout->add_option("--policy", ra->policy, "Artefact; default: the newest");
  auto [identify, id] = add("identify", "Simulator parameters from a recording", jobs::CompileIdentify);
  AddIdentifyFlags(identify, &id->options);
  identify->add_option("--recording", id->recording, "Artefact; default: the newest");
}

}  // namespace rg::cli
