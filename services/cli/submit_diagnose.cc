// `submit diagnose`: a recording set on this machine, diagnosed by workers.
#include <CLI/CLI.hpp>
#include <memory>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "coordinator/client/client.h"
#include "realitygrad/v1/artifact.pb.h"
#include "realitygrad/v1/control.pb.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"
#include "services/cli/early_warnings.h"
#include "services/cli/job_terms.h"
#include "services/cli/job_view.h"
#include "services/cli/model_source.h"
#include "services/cli/packed_set.h"
#include "services/jobs/job_graphs.h"
#include "services/jobs/kinds.h"

namespace rg::cli {
namespace {

namespace pb = ::realitygrad::v1;
using nlohmann::json;

struct DiagnoseJobArguments {
  SetArguments sets;
  std::string out, request_id, model;
  jobs::DiagnoseOptions options;
  JobTerms terms;
  bool follow = false;
};

Status Fetch(coordinator::Client& client, const pb::GetJobReply& job, const std::string& out) {
  for (const pb::TaskInfo& task : job.tasks()) {
    for (const pb::TaskOutput& output : task.outputs()) {
      const std::string name = output.kind() == jobs::kArtifactDiagnosis ? "diagnosis.json"
                               : output.kind() == jobs::kArtifactModel   ? "model.json"
                               : output.kind() == jobs::kArtifactReport  ? "report.html"
                               : output.kind() == jobs::kArtifactMotion  ? "motion.csv"
                                                                         : "";
      if (name.empty()) continue;
      RG_ASSIGN_OR_RETURN(const std::string bytes, client.GetArtifact(output.sha256()));
      RG_RETURN_IF_ERROR(WriteFileAtomically(out + "/" + name, bytes));
    }
  }
  return Status::Ok();
}

// What the task would refuse after it has waited for a worker is refused here.
Status WarnFirst(const Context& context, const DiagnoseJobArguments& arguments) {
  RG_ASSIGN_OR_RETURN(const recordings::RecordingSet set, arguments.sets.Load());
  std::optional<sim::ModelFile> model;
  if (!arguments.model.empty()) {
    RG_ASSIGN_OR_RETURN(model, sim::LoadModelFile(arguments.model));
  }
  return SayWarnings(context, set, model, arguments.options.trust_effort).status();
}

Status SubmitDiagnose(Context& context, const DiagnoseJobArguments& arguments) {
  RG_RETURN_IF_ERROR(WarnFirst(context, arguments));
  RG_ASSIGN_OR_RETURN(const std::string bundle, PackedSet(arguments.sets));
  RG_ASSIGN_OR_RETURN(const auto client, context.Connect());
  pb::ArtifactInfo info;
  info.set_kind(jobs::kArtifactRecordingSet);
  info.set_metadata_json(json{{"name", arguments.sets.name()}}.dump());
  RG_ASSIGN_OR_RETURN(const std::string set, client->PutArtifact(bundle, info));
  std::string model;
  if (!arguments.model.empty()) {
    RG_ASSIGN_OR_RETURN(model, PutModelFile(*client, arguments.model));
  }
  pb::JobSpec job = jobs::CompileDiagnose(arguments.options, set, model);
  RG_RETURN_IF_ERROR(context.Usage(arguments.terms.Apply(*client, &job)));
  RG_ASSIGN_OR_RETURN(const int64_t id, client->Submit(job, arguments.request_id));
  if (!arguments.follow && arguments.out.empty()) {
    if (context.json()) {
      PrintJson("realitygrad.submitted/1", {{"job", id}});
    } else {
      Print(std::to_string(id));
      if (!context.quiet()) PrintNote("next: realitygrad job watch " + std::to_string(id));
    }
    return Status::Ok();
  }
  RG_ASSIGN_OR_RETURN(const pb::GetJobReply end, FollowJob(*client, id, -1, context.quiet()));
  RG_ASSIGN_OR_RETURN(const pb::GetJobReply whole, client->GetJob(id, true, false));
  if (!arguments.out.empty()) RG_RETURN_IF_ERROR(Fetch(*client, whole, arguments.out));
  if (context.json()) {
    PrintJson("realitygrad.job/1", coordinator::JobDetailsJson(whole, true));
  } else {
    Print(context.quiet() || !arguments.out.empty() ? arguments.out : JobDetails(whole, false));
  }
  context.exit_code = coordinator::ExitCodeOf(end.job().state());
  return Status::Ok();
}

}  // namespace

void AddSubmitDiagnose(CLI::App& submit, Context& context) {
  auto arguments = std::make_shared<DiagnoseJobArguments>();
  CLI::App* command = submit.add_subcommand(
      "diagnose", "Which physics a model leaves out, led by a worker's task, its fits on all workers");
  arguments->sets.AddTo(command);
  command->add_option("--out", arguments->out,
                      "Wait, and write diagnosis.json, model.json, report.html here");
  command->add_option(
      "--model", arguments->model,
      "A model.json to start from, identified or diagnosed before, instead of the set's URDF");
  command->add_option("--window", arguments->options.window_s, "Length of the judged predictions [s]")
      ->capture_default_str();
  command->add_option("--threads", arguments->options.threads, "0: all cores of the worker")
      ->capture_default_str();
  command->add_option("--seed", arguments->options.seed)->capture_default_str();
  command->add_flag("--trust-effort", arguments->options.trust_effort,
                    "Go on where the sign or the unit of an effort looks wrong");
  arguments->terms.AddTo(command);
  command->add_option("--request-id", arguments->request_id, "The same id never makes a second job");
  command->add_flag("--follow", arguments->follow, "Until it ends, with progress");
  command->callback([&context, arguments] { context.Failed(SubmitDiagnose(context, *arguments)); });
}

}  // namespace rg::cli
