// `robot hold|release|holds`: nothing moves a robot while somebody has his hands in it.
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "common/base/clock.h"
#include "coordinator/client/client.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"
#include "services/cli/job_view.h"
#include "services/cli/output.h"

namespace rg::cli {
namespace {

using nlohmann::json;

struct HoldArguments {
  std::string robot, reason;
};

void Hold(Context& context, const HoldArguments& arguments, bool release) {
  auto client = context.Connect();
  if (context.Failed(client.status())) return;
  if (context.Failed((*client)->HoldRobot(arguments.robot, arguments.reason, release))) return;
  if (context.quiet()) return;
  PrintNote(release ? arguments.robot + " may move again"
                    : "no rollout begins on " + arguments.robot +
                          " until `realitygrad robot release`; one under way goes on (`realitygrad agent stop` stops it)");
}

void ListHolds(Context& context) {
  auto client = context.Connect();
  if (context.Failed(client.status())) return;
  const auto status = (*client)->CoordinatorStatus();
  if (context.Failed(status.status())) return;
  json list = json::array();
  TextTable table({"ROBOT", "HELD BY", "SINCE", "REASON"});
  for (const auto& hold : status->holds()) {
    list.push_back({{"robot", hold.robot()}, {"by", hold.by()}, {"since", FormatWallTime(hold.since_ns())}, {"reason", hold.reason()}});
    table.AddRow({hold.robot(), hold.by(), TimeText(hold.since_ns()), hold.reason()});
  }
  if (context.json()) return PrintJson("realitygrad.holds/1", {{"holds", list}});
  Print(table.empty() ? "no robot is held" : table.ToString());
}

}  // namespace

void AddRobotCommands(CLI::App& app, Context& context) {
  CLI::App* robot = app.add_subcommand("robot", "Hold a robot, so that nothing moves it, or release it")->require_subcommand(1);
  auto arguments = std::make_shared<HoldArguments>();
  CLI::App* hold = robot->add_subcommand("hold", "No rollout begins on it until it is released");
  hold->add_option("ROBOT", arguments->robot)->required();
  hold->add_option("REASON", arguments->reason, "Shown wherever its rollouts wait")->required();
  hold->callback([&context, arguments] { Hold(context, *arguments, false); });
  CLI::App* release = robot->add_subcommand("release", "It may move again");
  release->add_option("ROBOT", arguments->robot)->required();
  release->callback([&context, arguments] { Hold(context, *arguments, true); });
  robot->add_subcommand("holds", "Which are held, by whom and why")->callback([&context] { ListHolds(context); });
}

}  // namespace rg::cli
