// The commands of `realitygrad`, in the order of its help.
#include <CLI/CLI.hpp>

#include "services/cli/commands.h"
#include "services/cli/context.h"

namespace rg::cli {
namespace {

// A command of realitygrad-lab, which reads all of this command line itself.
void AddLabCommand(CLI::App& app, Context& context, const char* name, const char* help) {
  CLI::App* command = app.add_subcommand(name, help)->prefix_command()->fallthrough(false);
  command->set_help_flag();
  command->callback([&context] { context.Failed(BecomeProgram("realitygrad-lab", context.argv)); });
}

}  // namespace

void AddCommands(CLI::App& app, Context& context) {
  AddRunCommand(app, context);
  AddLabCommand(app, context, "prove", "Examine the diagnosis blind: concealed physics by another engine");
  AddModelCommands(app, context);
  AddCheckCommand(app, context);
  AddDiagnoseCommand(app, context);
  AddImportCommands(app, context);
  AddEffectsCommand(app, context);
  AddSubmitCommands(app, context);
  AddJobCommands(app, context);
  AddRobotCommands(app, context);
  AddParameterCommands(app, context);
  AddPolicyCommands(app, context);
  AddArtifactCommands(app, context);
  AddBackupCommands(app, context);
  AddLabCommand(app, context, "experiment", "The paper's experiments again, beside the paper's figures");
  AddLabCommand(app, context, "bench", "Measure this machine: the project's figures beside rivals'");
  AddSystemCommands(app, context);
  AddCompletionCommand(app);
}

}  // namespace rg::cli
