#include <CLI/CLI.hpp>
#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <sstream>
#include <utility>

#include "common/base/file.h"
#include "common/model/robot_model.h"
#include "common/sim/model_file.h"
#include "coordinator/client/client.h"
#include "realitygrad/v1/artifact.pb.h"
#include "realitygrad/v1/control.pb.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"
#include "services/cli/iteration_flags.h"
#include "services/cli/job_terms.h"
#include "services/cli/job_view.h"
#include "services/cli/model_source.h"
#include "services/cli/robot_profile.h"
#include "services/jobs/job_graphs.h"
#include "services/jobs/kinds.h"
#include "services/rollouts/recording_bundle.h"
#include "services/rollouts/reference_motion.h"
#include "services/trajectories/motion_limits.h"
#include "services/trajectories/reference_tracking.h"

namespace rg::cli {
namespace {

namespace pb = ::realitygrad::v1;
using nlohmann::json;

struct SubmitArguments {
  jobs::IterationOptions options;
  std::string robot = "mico2", model = "latest", policy, recording, request_id;
  std::string trajectory, out;  // of a rollout
  std::vector<std::string> shards;
  int64_t shards_of_job = 0;
  JobTerms terms;
  bool wait = false, follow = false, dry_run = false;
  double timeout_s = -1;
};

// Jobs of a file, to be submitted together.
struct Batch {
  coordinator::Client* client = nullptr;
  pb::SubmitManyRequest request;
  Status status;  // of the line just read
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

// The motion in `file` is within what the model's robot can do; uploaded as an artefact.
Result<std::string> UploadMotion(coordinator::Client& client, const RobotProfile& profile,
                                 const std::string& model_sha256, const std::string& file, double rate_hz) {
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  RG_ASSIGN_OR_RETURN(const std::string model_json, client.GetArtifact(model_sha256));
  RG_ASSIGN_OR_RETURN(const sim::ModelFile model, sim::ModelFromJson(model_json, "model"));
  RG_ASSIGN_OR_RETURN(const auto motion, rollouts::ParseMotion(text, file, model.plant.model()));
  const Eigen::VectorXd peak = Eigen::Map<const Eigen::VectorXd>(
      profile.peak_torque.data(), static_cast<Eigen::Index>(profile.peak_torque.size()));
  const auto limits = trajectories::MotionLimits::FromModel(model.plant.model(), peak);
  const auto named = [&](const Status& status) { return status.WithPrefix(file); };
  if (const Status kept =
          rollouts::CheckMotion(motion, {limits.position_lower, limits.position_upper, limits.velocity});
      !kept.ok())
    return named(kept);
  const auto plan = trajectories::PlanTracking(
      model.plant, model.values,
      [&](double t, Eigen::VectorXd* q, Eigen::VectorXd* v, Eigen::VectorXd* a) { motion.At(t, q, v, a); },
      motion.duration_s(), 1.0 / rate_hz, limits.torque);
  if (!plan.ok()) return named(plan.status());
  pb::ArtifactInfo info;
  info.set_kind(jobs::kArtifactMotion);
  info.set_metadata_json(json{
      {"name", std::filesystem::path(file).filename().string()},
      {"duration_s",
       motion.duration_s()}}.dump());
  return client.PutArtifact(text, info);
}

// The recording of a rollout's job as a set in a folder.
Status FetchRecording(coordinator::Client& client, int64_t job, const std::string& out) {
  RG_ASSIGN_OR_RETURN(const auto made, client.ListArtifacts(jobs::kArtifactRecording, job, 1));
  if (made.empty()) return NotFoundError("job " + std::to_string(job) + " left no recording");
  RG_ASSIGN_OR_RETURN(const std::string bytes, client.GetArtifact(made.front().sha256()));
  return rollouts::ExtractBundle(bytes, out);
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
  if (!arguments.trajectory.empty()) {
    RG_ASSIGN_OR_RETURN(inputs.motion, UploadMotion(client, profile, inputs.model, arguments.trajectory,
                                                    arguments.options.rollout.rate_hz));
  } else if (what == "rollout" && arguments.options.rollout.controller == "policy") {
    RG_ASSIGN_OR_RETURN(inputs.policy, FindArtifact(client, arguments.policy, jobs::kArtifactPolicy));
  }
  if (what == "identify") {
    RG_ASSIGN_OR_RETURN(inputs.recording,
                        FindArtifact(client, arguments.recording, jobs::kArtifactRecording));
  }
  return inputs;
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

// The job as it was asked for. What is found out about it with the coordinator costs some requests.
Result<pb::JobSpec> CompileJob(Context& context, coordinator::Client& client, const std::string& what, Compile compile,
                               SubmitArguments& arguments) {
  RG_ASSIGN_OR_RETURN(const Settings settings, context.Resolve());
  RG_ASSIGN_OR_RETURN(const RobotProfile profile, LoadRobotProfile(RobotsFolder(settings), arguments.robot));
  TakeProfile(profile, &arguments.options);
  RG_RETURN_IF_ERROR(context.Usage(jobs::Validate(arguments.options)));
  if (!arguments.trajectory.empty()) arguments.options.rollout.controller = "trajectory";
  RG_RETURN_IF_ERROR(CheckWritable(arguments.out));
  RG_ASSIGN_OR_RETURN(const auto inputs, FindInputs(client, profile, what, arguments));
  pb::JobSpec job = compile(arguments.options, inputs);
  RG_RETURN_IF_ERROR(context.Usage(arguments.terms.Apply(client, &job)));
  return job;
}

Status AddToBatch(Context& context, const std::string& what, Compile compile, SubmitArguments& arguments, Batch& batch) {
  if (arguments.wait || arguments.follow || arguments.dry_run || !arguments.out.empty())
    return InvalidError("--wait, --follow, --out and --dry-run are not for a job of a file");
  RG_ASSIGN_OR_RETURN(pb::JobSpec job, CompileJob(context, *batch.client, what, compile, arguments));
  pb::SubmitRequest& submit = *batch.request.add_submits();
  submit.set_request_id(arguments.request_id);
  *submit.mutable_job() = std::move(job);
  return Status::Ok();
}

Status Submit(Context& context, const std::string& what, Compile compile, SubmitArguments& arguments) {
  RG_ASSIGN_OR_RETURN(const auto client, context.Connect());
  RG_ASSIGN_OR_RETURN(const pb::JobSpec job, CompileJob(context, *client, what, compile, arguments));
  if (arguments.dry_run) return PrintGraph(context, job);
  RG_ASSIGN_OR_RETURN(const int64_t id, client->Submit(job, arguments.request_id));
  if (!arguments.wait && !arguments.follow && arguments.out.empty()) {
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
  const bool succeeded = end.job().state() == pb::JOB_STATE_SUCCEEDED;
  if (!arguments.out.empty()) {
    const Status fetched = FetchRecording(*client, id, arguments.out);  // of a failed one, where it left any
    if (succeeded) RG_RETURN_IF_ERROR(fetched);
    if (!succeeded && fetched.ok()) PrintNote("what was recorded is in " + arguments.out);
  }
  if (context.json()) {
    PrintJson("realitygrad.job/1", coordinator::JobDetailsJson(end, true));
  } else {
    Print(context.quiet() ? std::to_string(id) : JobDetails(end, false));
    if (succeeded && !arguments.out.empty() && !context.quiet())
      PrintNote("next: realitygrad diagnose SET " + arguments.out + " --out DIR");
  }
  context.exit_code = coordinator::ExitCodeOf(end.job().state());
  return Status::Ok();
}

// `batch` null: each is submitted by itself.
void AddKinds(CLI::App* submit, Context& context, Batch* batch) {
  const auto add = [&](const char* what, const char* help, Compile compile) {
    auto arguments = std::make_shared<SubmitArguments>();
    CLI::App* command = submit->add_subcommand(what, help);
    command->add_option("--robot", arguments->robot, "Profile: a name, or a file")->capture_default_str();
    command->add_option("--model", arguments->model, "latest, nominal, a model.json, or an artefact")
        ->capture_default_str();
    command->add_option("--seed", arguments->options.seed)->capture_default_str();
    arguments->terms.AddTo(command);
    command->add_option("--request-id", arguments->request_id, "The same id never makes a second job");
    command->add_flag("--wait", arguments->wait, "Until it ends; the exit code says how");
    command->add_flag("--follow", arguments->follow, "The same, with progress");
    command->add_option("--timeout", arguments->timeout_s, "Seconds to wait at the most");
    command->add_flag("--dry-run", arguments->dry_run, "Show what would be submitted");
    command->callback([&context, arguments, what, compile, batch] {
      if (batch == nullptr) return context.Failed(Submit(context, what, compile, *arguments)), void();
      batch->status = AddToBatch(context, what, compile, *arguments, *batch);
    });
    return std::pair{command, arguments};
  };
  auto [iteration, ia] =
      add("iteration", "Trajectories, policy, rollout, identification", jobs::CompileIteration);
  AddTrajectoryFlags(iteration, &ia->options);
  AddTrainFlags(iteration, &ia->options);
  AddLearningFlags(iteration, &ia->options);
  AddRolloutFlags(iteration, &ia->options);
  AddLoopDiagnosisFlags(iteration, &ia->options);
  AddIdentifyFlags(iteration, &ia->options);
  AddPartialFlag(iteration, &ia->options);
  auto [trajectories, ta] =
      add("trajectories", "Optimal trajectories between random poses", jobs::CompileTrajectories);
  AddTrajectoryFlags(trajectories, &ta->options);
  auto [train, tr] = add("train", "A policy from trajectories", jobs::CompileTrain);
  AddTrainFlags(train, &tr->options);
  train->add_option("--shards", tr->shards, "Artefacts; default: of --of-job")->delimiter(',');
  train->add_option("--of-job", tr->shards_of_job, "The job that made the trajectories; default: the newest");
  auto [rollout, ra] = add("rollout", "A policy on the robot, recorded", jobs::CompileRollout);
  AddRolloutFlags(rollout, &ra->options);
  AddPartialFlag(rollout, &ra->options);
  rollout->add_option("--policy", ra->policy, "Artefact; default: the newest");
  rollout->add_option(
      "--trajectory", ra->trajectory,
      "CSV of a motion (time, position.<joint>…), as a diagnosis proposes it, instead of a policy");
  rollout->add_option("--out", ra->out, "Wait, and write the recording set here");
  auto [identify, id] = add("identify", "Simulator parameters from a recording", jobs::CompileIdentify);
  AddIdentifyFlags(identify, &id->options);
  AddPartialFlag(identify, &id->options);
  identify->add_option("--recording", id->recording, "Artefact; default: the newest");
}

// A line is what follows `realitygrad submit`, as a JSON array of words.
Status AddLine(Context& context, const std::string& line, Batch& batch) {
  const json words = json::parse(line, nullptr, false);
  const bool are_words = words.is_array() && std::all_of(words.begin(), words.end(), [](const json& w) { return w.is_string(); });
  if (!are_words) return InvalidError("must be an array of strings: [\"trajectories\", \"--seed\", \"7\"]");
  auto reversed = words.get<std::vector<std::string>>();
  std::reverse(reversed.begin(), reversed.end());
  CLI::App app;
  app.require_subcommand(1);
  AddKinds(&app, context, &batch);
  try {
    app.parse(reversed);
  } catch (const CLI::ParseError& error) {
    return InvalidError(error.what());
  }
  return std::exchange(batch.status, Status::Ok());
}

// All lines or, if one makes no sense, none.
Status SubmitFile(Context& context, const std::string& path) {
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  RG_ASSIGN_OR_RETURN(const auto client, context.Connect());
  Batch batch;
  batch.client = client.get();
  std::istringstream lines(text);
  std::string line;
  std::vector<int> numbers;  // of the lines with a job
  for (int number = 1; std::getline(lines, line); ++number) {
    if (line.find_first_not_of(" \t\r") == std::string::npos) continue;
    const Status added = AddLine(context, line, batch);
    if (!added.ok()) return added.WithPrefix(path + ": line " + std::to_string(number));
    numbers.push_back(number);
  }
  RG_ASSIGN_OR_RETURN(const auto reply, client->SubmitMany(std::move(batch.request)));
  json ids = json::array();
  for (int i = 0; i < reply.jobs_size(); ++i) {
    const std::string where = path + ": line " + std::to_string(numbers[static_cast<size_t>(i)]) + ": ";
    if (!reply.errors(i).empty()) {
      context.Failed(FailedPreconditionError(where + reply.errors(i)));
    } else if (!context.json()) {
      Print(std::to_string(reply.jobs(i)));
    }
    ids.push_back(reply.jobs(i) == 0 ? json() : json(reply.jobs(i)));
  }
  if (context.json()) PrintJson("realitygrad.submitted-many/1", {{"jobs", ids}});
  return Status::Ok();
}

}  // namespace

void AddSubmitCommands(CLI::App& app, Context& context) {
  CLI::App* submit = app.add_subcommand("submit", "Submit a job to the coordinator, or those of a file")->require_subcommand(0, 1);
  AddSubmitDiagnose(*submit, context);
  AddKinds(submit, context, nullptr);
  auto file = std::make_shared<std::string>();
  submit->add_option("--file", *file, "One job a line, each an array of the words that follow `submit`: [\"train\", \"--seed\", \"2\"]");
  submit->callback([&context, submit, file] {
    if (!submit->get_subcommands().empty()) return;
    if (file->empty()) throw CLI::RequiredError("a job, or --file");
    context.Failed(SubmitFile(context, *file));
  });
}

}  // namespace rg::cli
