// realitygrad: the command line. `realitygrad coordinator|worker|agent …` become those programs.
#include <CLI/CLI.hpp>
#include <cstring>

#include "services/cli/commands.h"
#include "services/cli/context.h"
#include "services/cli/program.h"

namespace {

bool IsService(int argc, char** argv) {
  if (argc < 2) return false;
  // `worker drain NAME` is a command about a worker, not the worker.
  if (argc >= 3 && std::strcmp(argv[1], "worker") == 0 && std::strcmp(argv[2], "drain") == 0) return false;
  for (const char* name : {"coordinator", "worker", "agent"}) {
    if (std::strcmp(argv[1], name) == 0) return true;
  }
  return false;
}

int BecomeService(char** argv) {
  const std::string program = std::string("realitygrad-") + argv[1];
  argv[1] = argv[0];
  return rg::cli::Fail(rg::cli::BecomeProgram(program, argv + 1));
}

void AddAll(CLI::App& app, rg::cli::Context& context) {
  app.add_subcommand("coordinator", "Run the coordinator (realitygrad coordinator --help)");
  app.add_subcommand("agent",
                     "Run the agent beside a robot (realitygrad agent --help), or tell it: agent "
                     "status|watch|arm|disarm|stop|clear");
  rg::cli::AddCommands(app, context);
}

}  // namespace

int main(int argc, char** argv) {
  if (IsService(argc, argv)) return BecomeService(argv);
  return rg::cli::RunProgram(argc, argv,
                             "RealityGrad closes the gap between a simulation and a robot.\n"
                             "Start with: realitygrad run",
                             AddAll);
}
