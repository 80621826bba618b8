#include "services/cli/program.h"

#include <CLI/CLI.hpp>
#include <cstdio>

#include "common/base/finite_flags.h"
#include "common/base/log.h"
#include "common/base/memory.h"
#include "services/cli/context.h"
#include "services/cli/output.h"

namespace rg::cli {
namespace {

// Said even where the rest of the command line makes no sense.
bool WantsJson(int argc, char** argv) {
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i], next = i + 1 < argc ? argv[i + 1] : "";
    if (word == "--output=json" || ((word == "--output" || word == "-o") && next == "json")) return true;
  }
  return false;
}

}  // namespace

int RunProgram(int argc, char** argv, const char* about, void (*add_commands)(CLI::App&, Context&)) {
  KeepFreedMemory();
  InitLogging("realitygrad", "warn");

  CLI::App app{about};
  app.set_version_flag("--version", std::string(RG_VERSION));
  app.require_subcommand(1);
  app.fallthrough();

  Context context;
  context.argv = argv;
  std::string output = "table";
  app.add_option("--output,-o", output, "table, json or quiet")->capture_default_str();
  app.add_option("--coordinator", context.flags.coordinator.value, "Address of the coordinator");
  app.add_option("--key", context.flags.key.value, "This user's key file, for encrypted connections");
  app.add_option("--server-key", context.flags.server_key.value, "The coordinator's public key file");
  app.add_option("--robots", context.flags.robots.value, "Folder of robot profiles");
  app.parse_complete_callback([&] {
    CheckFlagsFinite(app);
    const auto format = ParseOutputFormat(output);
    if (!format.ok()) throw CLI::ValidationError(format.status().message(), kExitUsage);
    context.output = *format;
  });
  add_commands(app, context);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) return app.exit(error);  // --help, --version
    const auto rest = app.remaining(true);
    const std::string what = dynamic_cast<const CLI::RequiredError*>(&error) && !rest.empty()
                                 ? "there is no command '" + rest.front() + "'"
                                 : error.what();
    std::fprintf(stderr, "realitygrad: usage: %s (--help says more)\n", what.c_str());
    if (WantsJson(argc, argv)) PrintJsonError(InvalidError(what));
    return kExitUsage;
  } catch (const std::bad_alloc&) {
    std::fprintf(stderr, "realitygrad: resource exhausted: out of memory\n");
    return kExitError;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "realitygrad: internal: %s\n", error.what());
    return kExitError;
  }
  if (context.json() && !context.error.ok() && !AnythingPrinted()) PrintJsonError(context.error);
  return context.exit_code;
}

}  // namespace rg::cli
