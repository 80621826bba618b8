// realitygrad-lab: examinations of the diagnosis, the paper's experiments, benches. `realitygrad prove …`
// starts it.
#include "services/cli/program.h"
#include "services/lab/lab_commands.h"

int main(int argc, char** argv) {
  return rg::cli::RunProgram(argc, argv, "The laboratory of RealityGrad",
                             [](CLI::App& app, rg::cli::Context& context) {
                               rg::lab::AddProveCommand(app, context);
                               rg::lab::AddExperimentCommand(app, context);
                               rg::lab::AddBenchCommand(app, context);
                             });
}
