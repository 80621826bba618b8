// The commands of `realitygrad`, in the order of its help.
#include "services/cli/commands.h"

namespace rg::cli {

void AddCommands(CLI::App& app, Context& context) {
  AddRunCommand(app, context);
  AddProveCommand(app, context);
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
  AddExperimentCommand(app, context);
  AddBenchCommand(app, context);
  AddSystemCommands(app, context);
  AddCompletionCommand(app);
}

}  // namespace rg::cli
