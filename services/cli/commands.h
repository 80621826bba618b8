// The subcommands of `realitygrad`, grouped as their files are. Each function adds its commands to
// `app`; a command's callback does the work and sets context.exit_code.
#pragma once

#include <string>

namespace CLI {
class App;
}

namespace rg::cli {

class Context;

void AddJobCommands(CLI::App& app, Context& context);        // jobs, job …, workers, explain
void AddParameterCommands(CLI::App& app, Context& context);  // params …
void AddArtifactCommands(CLI::App& app, Context& context);   // artifacts …
void AddSubmitCommands(CLI::App& app, Context& context);     // submit …
void AddModelCommands(CLI::App& app, Context& context);      // sysid, predict
void AddRunCommand(CLI::App& app, Context& context);         // run
void AddSystemCommands(CLI::App& app, Context& context);     // doctor, config, keys

// "last", "5": the id a client call takes (0 is the newest).
long ParseJobId(const std::string& text, Context& context);

}  // namespace rg::cli
