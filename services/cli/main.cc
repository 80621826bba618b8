// realitygrad: the command line. `realitygrad coordinator|worker|agent …` become those programs.
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cerrno>
#include <cstdio>
#include <cstring>

#include "common/base/finite_flags.h"
#include "common/base/log.h"
#include "common/base/memory.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"

namespace {

const char* const kServices[] = {"coordinator", "worker", "agent"};

bool IsService(int argc, char** argv) {
  if (argc < 2) return false;
  // `worker drain NAME` is a command about a worker, not the worker.
  if (argc >= 3 && std::strcmp(argv[1], "worker") == 0 && std::strcmp(argv[2], "drain") == 0) return false;
  for (const char* name : kServices) {
    if (std::strcmp(argv[1], name) == 0) return true;
  }
  return false;
}

int BecomeService(char** argv) {
  const std::string program = rg::cli::SiblingProgram(std::string("realitygrad-") + argv[1]);
  argv[1] = argv[0];
  execv(program.c_str(), argv + 1);
  return rg::cli::Fail(rg::NotFoundError(program + ": cannot start: " + std::strerror(errno)));
}

// Said even where the rest of the command line makes no sense.
bool WantsJson(int argc, char** argv) {
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i], next = i + 1 < argc ? argv[i + 1] : "";
    if (word == "--output=json" || ((word == "--output" || word == "-o") && next == "json")) return true;
  }
  return false;
}

void AddServiceHelp(CLI::App& app) {
  app.add_subcommand("coordinator", "Run the coordinator (realitygrad coordinator --help)");
  app.add_subcommand("agent",
                     "Run the agent beside a robot (realitygrad agent --help), or tell it: agent "
                     "status|watch|arm|disarm|stop|clear");
}

}  // namespace

int main(int argc, char** argv) {
  if (IsService(argc, argv)) return BecomeService(argv);
  rg::KeepFreedMemory();
  rg::InitLogging("realitygrad", "warn");

  CLI::App app{
      "RealityGrad closes the gap between a simulation and a robot.\n"
      "Start with: realitygrad run"};
  app.set_version_flag("--version", std::string(RG_VERSION));
  app.require_subcommand(1);
  app.fallthrough();

  rg::cli::Context context;
  std::string output = "table";
  app.add_option("--output,-o", output, "table, json or quiet")->capture_default_str();
  app.add_option("--coordinator", context.flags.coordinator.value, "Address of the coordinator");
  app.add_option("--key", context.flags.key.value, "This user's key file, for encrypted connections");
  app.add_option("--server-key", context.flags.server_key.value, "The coordinator's public key file");
  app.add_option("--robots", context.flags.robots.value, "Folder of robot profiles");
  app.parse_complete_callback([&] {
    rg::CheckFlagsFinite(app);
    const auto format = rg::cli::ParseOutputFormat(output);
    if (!format.ok()) throw CLI::ValidationError(format.status().message(), rg::cli::kExitUsage);
    context.output = *format;
  });
  AddServiceHelp(app);
  rg::cli::AddCommands(app, context);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) return app.exit(error);  // --help, --version
    const auto rest = app.remaining(true);
    const std::string what = dynamic_cast<const CLI::RequiredError*>(&error) && !rest.empty()
                                 ? "there is no command '" + rest.front() + "'"
                                 : error.what();
    std::fprintf(stderr, "realitygrad: usage: %s (--help says more)\n", what.c_str());
    if (WantsJson(argc, argv)) rg::cli::PrintJsonError(rg::InvalidError(what));
    return rg::cli::kExitUsage;
  } catch (const std::bad_alloc&) {
    std::fprintf(stderr, "realitygrad: resource exhausted: out of memory\n");
    return rg::cli::kExitError;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "realitygrad: internal: %s\n", error.what());
    return rg::cli::kExitError;
  }
  if (context.json() && !context.error.ok() && !rg::cli::AnythingPrinted()) rg::cli::PrintJsonError(context.error);
  return context.exit_code;
}
