// `params export`: the better simulator, for other tools.
#include <CLI/CLI.hpp>
#include <memory>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "common/sim/export_mjcf.h"
#include "common/sim/export_urdf.h"
#include "common/sim/model_file.h"
#include "coordinator/client/client.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"

namespace rg::cli {
namespace {

struct ExportArguments {
  std::string robot, model, urdf, mjcf;
  unsigned version = 0;
};

// The model file, or the model of a version of the parameter history.
Result<sim::ModelFile> LoadModelToExport(Context& context, const ExportArguments& arguments) {
  if (!arguments.model.empty()) return sim::LoadModelFile(arguments.model);
  RG_ASSIGN_OR_RETURN(const auto client, context.Connect());
  RG_ASSIGN_OR_RETURN(const std::string robot, ChooseRobot(*client, arguments.robot));
  RG_ASSIGN_OR_RETURN(const auto version, client->Parameters(robot, arguments.version));
  RG_ASSIGN_OR_RETURN(const std::string bytes, client->GetArtifact(version.model_sha256()));
  return sim::ModelFromJson(bytes, robot + " version " + std::to_string(version.version()));
}

Status WriteOne(const char* format, const std::string& path, const Result<sim::ExportedModel>& exported,
                nlohmann::json* files) {
  RG_RETURN_IF_ERROR(exported.status());
  RG_RETURN_IF_ERROR(WriteFileAtomically(path, exported->text));
  files->push_back({{"format", format}, {"path", path}, {"left_out", exported->left_out}});
  return Status::Ok();
}

Status Export(Context& context, const ExportArguments& arguments) {
  if (arguments.urdf.empty() && arguments.mjcf.empty())
    return InvalidError("nothing to write: give --urdf OUT.urdf, --mjcf OUT.xml, or both");
  RG_ASSIGN_OR_RETURN(const sim::ModelFile model, LoadModelToExport(context, arguments));
  nlohmann::json files = nlohmann::json::array();
  if (!arguments.urdf.empty()) {
    RG_RETURN_IF_ERROR(WriteOne("urdf", arguments.urdf, sim::ExportUrdf(model.plant, model.values), &files));
  }
  if (!arguments.mjcf.empty()) {
    RG_RETURN_IF_ERROR(WriteOne("mjcf", arguments.mjcf, sim::ExportMjcf(model.plant, model.values), &files));
  }
  if (context.json()) {
    PrintJson("realitygrad.export/1", {{"version", model.version}, {"files", files}});
    return Status::Ok();
  }
  for (const nlohmann::json& file : files) {
    Print(file["path"].get<std::string>());
    if (context.quiet()) continue;
    for (const nlohmann::json& line : file["left_out"]) Print("  " + line.get<std::string>());
  }
  return Status::Ok();
}

}  // namespace

void AddExportCommand(CLI::App& params, Context& context) {
  auto arguments = std::make_shared<ExportArguments>();
  CLI::App* command = params.add_subcommand(
      "export", "Write an identified model as URDF and MJCF; says what a format cannot hold");
  command->add_option("VERSION", arguments->version, "Default: the latest");
  command->add_option("--robot", arguments->robot, "Name; needed where several have parameters");
  command->add_option("--model", arguments->model, "A model.json instead of the parameter history");
  command->add_option("--urdf", arguments->urdf, "File to write");
  command->add_option("--mjcf", arguments->mjcf, "File to write, for MuJoCo");
  command->callback([&context, arguments] { context.Failed(Export(context, *arguments)); });
}

}  // namespace rg::cli
