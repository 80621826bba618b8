// The commands of `realitygrad-lab`; a command's callback does the work and sets context.exit_code.
#pragma once

namespace CLI {
class App;
}

namespace rg::cli {
class Context;
}

namespace rg::lab {

void AddProveCommand(CLI::App& app, cli::Context& context);
void AddExperimentCommand(CLI::App& app, cli::Context& context);
void AddBenchCommand(CLI::App& app, cli::Context& context);

}  // namespace rg::lab
