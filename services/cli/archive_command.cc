#include "services/cli/archive_command.h"

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "coordinator/client/client.h"
#include "services/cli/context.h"

namespace rg::cli {
namespace {

using nlohmann::json;

struct ArchiveArguments {
  double older_than_days = 30.0;
  bool dry_run = false, yes = false;
};

Status Archive(Context& context, const ArchiveArguments& arguments) {
  RG_ASSIGN_OR_RETURN(const auto client, context.Connect());
  constexpr double kNsPerDay = 86'400e9;
  const bool dry_run = arguments.dry_run || !arguments.yes;
  RG_ASSIGN_OR_RETURN(
      const auto reply,
      client->ArchiveJobs(static_cast<int64_t>(arguments.older_than_days * kNsPerDay), dry_run));
  if (context.json()) {
    PrintJson("realitygrad.archive/1",
              {{"dry_run", dry_run},
               {"jobs", std::vector<int64_t>(reply.jobs().begin(), reply.jobs().end())},
               {"tasks", reply.tasks()}});
  } else if (context.quiet()) {
    for (const int64_t job : reply.jobs()) Print(std::to_string(job));
  } else {
    Print((dry_run ? "would archive " : "archived ") + std::to_string(reply.jobs_size()) + " jobs with " +
          std::to_string(reply.tasks()) + " tasks" +
          (dry_run ? ", whose logs, events and specifications would go: --yes does it" : ""));
  }
  return Status::Ok();
}

}  // namespace

void AddArchiveCommand(CLI::App* jobs, Context& context) {
  auto arguments = std::make_shared<ArchiveArguments>();
  CLI::App* archive = jobs->add_subcommand(
      "archive", "Move jobs that are over out of the way: still shown, without logs, events, specifications");
  archive->add_option("--older-than-days", arguments->older_than_days, "Since they ended")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  archive->add_flag("--dry-run", arguments->dry_run, "Only say what it would do (also without --yes)");
  archive->add_flag("--yes", arguments->yes, "Do it");
  archive->callback([&context, arguments] { context.Failed(Archive(context, *arguments)); });
}

}  // namespace rg::cli
