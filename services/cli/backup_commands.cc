#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "common/base/clock.h"
#include "common/store/artifact_store.h"
#include "common/store/parameter_store.h"
#include "common/store/restore.h"
#include "coordinator/client/client.h"
#include "coordinator/store/schema.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"

namespace rg::cli {
namespace {

// 2026-03-01T08-30-00.backup.db
std::string DefaultName() {
  std::string name = FormatWallTime(RealClock().WallNanos()).substr(0, 19);
  std::replace(name.begin(), name.end(), ':', '-');
  return name + ".backup.db";
}

void Backup(Context& context, const std::string& name) {
  auto client = context.Connect();
  if (context.Failed(client.status())) return;
  const auto made = (*client)->Backup(name.empty() ? DefaultName() : name);
  if (context.Failed(made.status())) return;
  if (context.json()) {
    PrintJson("realitygrad.backup/1", {{"path", made->path()}, {"bytes", made->bytes()}});
  } else {
    Print(made->path());
  }
}

void Restore(Context& context, const store::RestoreOptions& options) {
  const Status done =
      RestoreDatabase(options, {store::ArtifactStore::Schema(), store::ParameterStore::Schema(),
                                coordinator::CoordinatorSchema()});
  if (context.Failed(done)) return;
  if (context.json()) {
    PrintJson("realitygrad.restore/1", {{"path", options.path}});
  } else if (!context.quiet()) {
    PrintNote(options.path + " is as it was when the backup was made; start a coordinator with --db " +
              options.path);
  }
}

// Also beside a coordinator that works on it.
Result<std::vector<std::string>> ProblemsOf(const std::string& path) {
  constexpr int kMost = 100;
  store::DatabaseOptions options;
  options.path = path;
  options.read_only = true;
  const auto database = store::Database::Open(options, {});
  auto problems = database.ok() ? (*database)->Problems(kMost) : database.status();
  if (!problems.ok() && problems.status().code() == StatusCode::kDataLoss)
    return std::vector<std::string>{problems.status().message()};
  return problems;
}

void Check(Context& context, const std::string& path) {
  const auto problems = ProblemsOf(path);
  if (context.Failed(problems.status())) return;
  if (context.json()) {
    PrintJson("realitygrad.db_check/1", {{"path", path}, {"ok", problems->empty()}, {"problems", *problems}});
  } else {
    for (const std::string& problem : *problems) Print(problem);
    if (problems->empty() && !context.quiet()) Print(path + " is whole");
  }
  if (problems->empty()) return;
  context.Failed(DataLossError(path + ": damaged; `realitygrad restore BACKUP --db " + path +
                               " --overwrite` puts a backup in its place, and keeps this one"));
}

}  // namespace

void AddBackupCommands(CLI::App& app, Context& context) {
  auto name = std::make_shared<std::string>();
  CLI::App* backup = app.add_subcommand("backup", "Copy the coordinator's database while it works");
  backup->add_option("--name", *name, "Of the file, which is made beside the database (default: the time)");
  backup->callback([&context, name] { Backup(context, *name); });

  auto options = std::make_shared<store::RestoreOptions>();
  CLI::App* restore =
      app.add_subcommand("restore", "Make a backup a database again; no coordinator may run on it");
  restore->add_option("BACKUP", options->backup, "The file")->required();
  restore->add_option("--db", options->path, "The database")->required();
  restore->add_flag("--overwrite", options->overwrite, "Move a database that is there aside");
  restore->callback([&context, options] { Restore(context, *options); });

  auto path = std::make_shared<std::string>("realitygrad.db");
  CLI::App* db = app.add_subcommand("db", "The database on this machine")->require_subcommand(1);
  CLI::App* check = db->add_subcommand("check", "Look at every page of it for damage; a coordinator may work on it");
  check->add_option("--db", *path, "The database")->envname("REALITYGRAD_DB")->capture_default_str();
  check->callback([&context, path] { Check(context, *path); });
}

}  // namespace rg::cli
