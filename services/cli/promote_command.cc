// `params promote`: which version of a robot's parameters is current.
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "coordinator/client/client.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"

namespace rg::cli {
namespace {

struct PromoteArguments {
  std::string robot;
  unsigned version = 0;
  bool latest = false;
};

Status Promote(Context& context, const PromoteArguments& arguments) {
  if (arguments.latest == (arguments.version != 0))
    return context.Usage(InvalidError("which version? A number, or --latest"));
  RG_ASSIGN_OR_RETURN(const auto client, context.Connect());
  RG_ASSIGN_OR_RETURN(const std::string robot, ChooseRobot(*client, arguments.robot));
  RG_ASSIGN_OR_RETURN(const uint32_t current, client->PromoteParameters(robot, arguments.version));
  if (context.json()) {
    PrintJson("realitygrad.promotion/1",
              {{"robot", robot}, {"current", current}, {"follows_latest", arguments.latest}});
  } else if (context.quiet()) {
    Print(std::to_string(current));
  } else {
    Print(robot + ": " + (current == 0 ? "no version" : "version " + std::to_string(current)) + " is current" +
          (arguments.latest ? ", every later one that is not held back will be" : ": --model latest is this one"));
  }
  return Status::Ok();
}

}  // namespace

void AddPromoteCommand(CLI::App& params, Context& context) {
  auto arguments = std::make_shared<PromoteArguments>();
  CLI::App* command = params.add_subcommand(
      "promote", "Make a version the robot's current one, which `--model latest` follows");
  command->add_option("VERSION", arguments->version)->check(CLI::Range(1u, 1'000'000'000u));
  command->add_option("--robot", arguments->robot, "Name; needed where several have parameters");
  command->add_flag("--latest", arguments->latest, "None any more: the latest that is not held back is current again");
  command->callback([&context, arguments] { context.Failed(Promote(context, *arguments)); });
}

}  // namespace rg::cli
