// The commands of first/realitygrad, which deploy/quickstart builds and uses before the rest is there.
#include "services/cli/commands.h"

namespace rg::cli {

void AddCommands(CLI::App& app, Context& context) { AddRunCommand(app, context); }

}  // namespace rg::cli
