// The subcommands of `realitygrad`, grouped as their files are. Each function adds its commands to
// `app`; a command's callback does the work and sets context.exit_code.
#pragma once

#include <string>

#include "common/base/status.h"

namespace CLI {
class App;
}

namespace rg::coordinator {
class Client;
}

namespace rg::cli {

class Context;

// All that the program has: every_command.cc for realitygrad, first_commands.cc for first/realitygrad.
void AddCommands(CLI::App& app, Context& context);

void AddJobCommands(CLI::App& app, Context& context);        // jobs, job …, workers, explain
void AddLogCommand(CLI::App& job, Context& context);         // job logs
void AddDescribeCommand(CLI::App& job, Context& context);    // job describe
void AddRobotCommands(CLI::App& app, Context& context);      // robot …
void AddParameterCommands(CLI::App& app, Context& context);  // params …
void AddExportCommand(CLI::App& params, Context& context);   // params export
void AddPromoteCommand(CLI::App& params, Context& context);  // params promote
void AddPlotCommand(CLI::App& params, Context& context);     // params plot
void AddPolicyCommands(CLI::App& app, Context& context);     // policy …
void AddArtifactCommands(CLI::App& app, Context& context);   // artifacts …
void AddBackupCommands(CLI::App& app, Context& context);     // backup, restore, db check
void AddSubmitCommands(CLI::App& app, Context& context);     // submit …
void AddSubmitDiagnose(CLI::App& submit, Context& context);  // submit diagnose
void AddModelCommands(CLI::App& app, Context& context);      // sysid, predict
void AddCheckCommand(CLI::App& app, Context& context);       // check
void AddDiagnoseCommand(CLI::App& app, Context& context);    // diagnose
void AddImportCommands(CLI::App& app, Context& context);     // import, export
void AddEffectsCommand(CLI::App& app, Context& context);     // effects
void AddRunCommand(CLI::App& app, Context& context);         // run
void AddSystemCommands(CLI::App& app, Context& context);     // doctor, config, keys
void AddCompletionCommand(CLI::App& app);                    // completion

// The robot named, or the only one that has parameters.
Result<std::string> ChooseRobot(coordinator::Client& client, const std::string& named);

}  // namespace rg::cli
