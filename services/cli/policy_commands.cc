// `policy show` and `policy export`: a trained policy for people and for other programs.
#include <CLI/CLI.hpp>
#include <memory>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "coordinator/client/client.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"
#include "services/cli/model_source.h"
#include "services/jobs/kinds.h"
#include "services/policy/onnx.h"
#include "services/policy/policy.h"
#include "services/report/page.h"

namespace rg::cli {
namespace {

using nlohmann::json;

struct PolicyArguments {
  std::string named, file, onnx;
};

struct LoadedPolicy {
  policy::Policy policy;
  std::string source;  // hash or file
};

Result<LoadedPolicy> Load(Context& context, const PolicyArguments& arguments) {
  std::string bytes, source = arguments.file;
  if (arguments.file.empty()) {
    RG_ASSIGN_OR_RETURN(const auto client, context.Connect());
    RG_ASSIGN_OR_RETURN(source, FindArtifact(*client, arguments.named, jobs::kArtifactPolicy));
    RG_ASSIGN_OR_RETURN(bytes, client->GetArtifact(source));
  } else {
    RG_ASSIGN_OR_RETURN(bytes, ReadFile(arguments.file));
  }
  RG_ASSIGN_OR_RETURN(policy::Policy policy, policy::ParsePolicy(bytes, source));
  return LoadedPolicy{std::move(policy), source};
}

json DescriptionOf(const LoadedPolicy& loaded) {
  const policy::TrainingRecord& record = loaded.policy.record();
  json out = {{"policy", loaded.source},
              {"joints", loaded.policy.joints()},
              {"layers", loaded.policy.parts().network.sizes()},
              {"inputs", loaded.policy.input_size()},
              {"outputs", loaded.policy.output_size()},
              {"seed", record.seed},
              {"epochs", record.epochs},
              {"points", record.points},
              {"validation_points", record.validation_points}};
  if (!record.curve.empty()) {
    out["train_loss"] = record.curve.back().train;
    out["validation_loss"] = record.curve.back().validation;  // NaN becomes null
  }
  return out;
}

std::string TextOf(const json& d) {
  std::string joints, layers;
  for (const json& name : d["joints"]) joints += (joints.empty() ? "" : ", ") + name.get<std::string>();
  for (const json& size : d["layers"]) layers += (layers.empty() ? "" : " → ") + size.dump();
  std::string text = "policy   " + d["policy"].get<std::string>() + "\njoints   " + joints + "\nlayers   " +
                     layers + " (ReLU)\ntrained  " + d["epochs"].dump() + " epochs on " + d["points"].dump() +
                     " points, seed " + d["seed"].dump();
  if (d.contains("train_loss"))
    text += "\nloss     " + report::FormatNumber(d["train_loss"]) + " in training, " +
            (d["validation_loss"].is_number() ? report::FormatNumber(d["validation_loss"]) : "–") + " on " +
            d["validation_points"].dump() + " points kept apart (normalised units)";
  return text;
}

Status Show(Context& context, const PolicyArguments& arguments) {
  RG_ASSIGN_OR_RETURN(const LoadedPolicy loaded, Load(context, arguments));
  const json description = DescriptionOf(loaded);
  if (context.json()) {
    PrintJson("realitygrad.policy-description/1", description);
  } else {
    Print(TextOf(description));
  }
  return Status::Ok();
}

Status Export(Context& context, const PolicyArguments& arguments) {
  RG_ASSIGN_OR_RETURN(const LoadedPolicy loaded, Load(context, arguments));
  RG_RETURN_IF_ERROR(WriteFileAtomically(arguments.onnx, policy::ExportOnnx(loaded.policy, RG_VERSION)));
  if (context.json()) {
    PrintJson("realitygrad.export/1",
              {{"policy", loaded.source}, {"files", {{{"format", "onnx"}, {"path", arguments.onnx}}}}});
    return Status::Ok();
  }
  Print(arguments.onnx);
  if (!context.quiet())
    PrintNote("observation (batch × " + std::to_string(loaded.policy.input_size()) +
              "): q, q̇, q_goal → effort (batch × " + std::to_string(loaded.policy.output_size()) +
              "), SI units");
  return Status::Ok();
}

}  // namespace

void AddPolicyCommands(CLI::App& app, Context& context) {
  CLI::App* group = app.add_subcommand("policy", "Trained policies")->require_subcommand(1);
  const auto add = [&](const char* name, const char* help, Status (*run)(Context&, const PolicyArguments&)) {
    auto arguments = std::make_shared<PolicyArguments>();
    CLI::App* command = group->add_subcommand(name, help);
    command->add_option("POLICY", arguments->named, "Artefact; default: the newest");
    command->add_option("--file", arguments->file, "A policy file instead (artifacts get)");
    command->callback([&context, arguments, run] { context.Failed(run(context, *arguments)); });
    return std::pair{command, arguments};
  };
  add("show", "Joints, layers, training", Show);
  auto [command, arguments] = add("export", "Write it as ONNX, normalisation included", Export);
  command->add_option("--onnx", arguments->onnx, "File to write")->required();
}

}  // namespace rg::cli
