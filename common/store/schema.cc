#include "common/store/schema.h"

#include "common/base/clock.h"
#include "common/base/hash.h"

namespace rg::store {
namespace {

// Frozen: every version of the program must be able to read this table.
constexpr std::string_view kSchemaTable =
    "CREATE TABLE rg_migration ("
    "  module TEXT NOT NULL, version INTEGER NOT NULL, sha256 TEXT NOT NULL, applied_at TEXT NOT NULL,"
    "  PRIMARY KEY (module, version)) WITHOUT ROWID";

// Made with the database, or when an older one is opened.
constexpr std::string_view kIdentityTable =
    "CREATE TABLE rg_identity (id TEXT NOT NULL);"
    "INSERT INTO rg_identity VALUES (lower(hex(randomblob(16))));";

Result<int64_t> QueryInt(Database* database, std::string_view sql) {
  RG_ASSIGN_OR_RETURN(Statement query, database->Prepare(sql));
  RG_ASSIGN_OR_RETURN(const bool row, query.Step());
  return row ? query.Int(0) : 0;
}

void CheckModuleIsWellFormed(const Module& module) {
  RG_CHECK(!module.name.empty());
  for (size_t i = 0; i < module.migrations.size(); ++i)
    RG_CHECK(module.migrations[i].version == static_cast<int>(i) + 1)
        << "module " << module.name << ": migrations must be numbered 1, 2, 3, ...";
}

Status CheckIsOurs(Database* database) {
  RG_ASSIGN_OR_RETURN(const int64_t id, QueryInt(database, "PRAGMA application_id"));
  RG_ASSIGN_OR_RETURN(const int64_t tables, QueryInt(database, "SELECT count(*) FROM sqlite_master"));
  if (id == kApplicationId || (id == 0 && tables == 0)) return Status::Ok();
  return FailedPreconditionError(database->path() + ": an SQLite database, but not one of RealityGrad");
}

Result<bool> HasTable(Database* database, std::string_view name) {
  RG_ASSIGN_OR_RETURN(Statement query,
                      database->Prepare("SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = ?"));
  return query.Bind(1, name).Step();
}

Result<bool> HasSchemaTable(Database* database) { return HasTable(database, "rg_migration"); }

Status CheckApplied(Database* database, const Module& module) {
  const int known = static_cast<int>(module.migrations.size());
  RG_ASSIGN_OR_RETURN(const int installed, database->ModuleVersion(module.name));
  if (installed > known)
    return FailedPreconditionError(database->path() + ": module " + module.name + " has schema " +
                                   std::to_string(installed) + ", this program knows up to " +
                                   std::to_string(known) + ": use a newer realitygrad");
  RG_ASSIGN_OR_RETURN(
      Statement query,
      database->Prepare("SELECT version, sha256 FROM rg_migration WHERE module = ? ORDER BY version"));
  query.Bind(1, module.name);
  for (int expected = 1;; ++expected) {
    RG_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return Status::Ok();
    if (query.Int(0) != expected)
      return DataLossError(database->path() + ": module " + module.name + ": migration " +
                           std::to_string(expected) + " is missing from the version table");
    if (query.Text(1) != Sha256Hex(module.migrations[expected - 1].sql))
      return FailedPreconditionError(database->path() + ": module " + module.name + ": migration " +
                                     std::to_string(expected) +
                                     " is not the one this program has; the file was made by another build");
  }
}

Status ApplyMissing(Database* database, const Module& module) {
  RG_ASSIGN_OR_RETURN(const int installed, database->ModuleVersion(module.name));
  for (size_t i = installed; i < module.migrations.size(); ++i) {
    const Migration& migration = module.migrations[i];
    const std::string where = "module " + module.name + ", migration " + std::to_string(migration.version);
    const Status applied = database->Execute(migration.sql);
    if (!applied.ok()) return applied.WithPrefix(where);
    RG_ASSIGN_OR_RETURN(Statement note,
                        database->Prepare("INSERT INTO rg_migration (module, version, sha256, applied_at)"
                                          " VALUES (?, ?, ?, strftime('%Y-%m-%dT%H:%M:%SZ', 'now'))"));
    note.Bind(1, module.name).Bind(2, migration.version).Bind(3, Sha256Hex(migration.sql));
    RG_RETURN_IF_ERROR(note.Run());
  }
  return Status::Ok();
}

}  // namespace

const Module& OwnModule() {
  static const Module own{"database", {{1, kIdentityTable}}};
  return own;
}

Result<std::string> IdentityOf(Database* database, bool mint) {
  RG_ASSIGN_OR_RETURN(const bool has_table, HasTable(database, "rg_identity"));
  if (!has_table) return std::string();
  if (mint)
    RG_RETURN_IF_ERROR(database->Execute("UPDATE rg_identity SET id = lower(hex(randomblob(16))) WHERE id = ''"));
  RG_ASSIGN_OR_RETURN(Statement query, database->Prepare("SELECT id FROM rg_identity"));
  RG_ASSIGN_OR_RETURN(const bool row, query.Step());
  return row ? query.Text(0) : std::string();
}

Status MigrateAll(Database* database, const std::vector<Module>& modules) {
  for (const Module& module : modules) CheckModuleIsWellFormed(module);
  RG_RETURN_IF_ERROR(CheckIsOurs(database));
  return database->InTransaction([&]() -> Status {
    RG_ASSIGN_OR_RETURN(const bool has_table, HasSchemaTable(database));
    if (!has_table) {
      RG_RETURN_IF_ERROR(database->Execute("PRAGMA application_id = " + std::to_string(kApplicationId)));
      RG_RETURN_IF_ERROR(database->Execute(kSchemaTable));
    }
    RG_RETURN_IF_ERROR(CheckNotNewer(database, modules));
    for (const Module& module : modules) RG_RETURN_IF_ERROR(ApplyMissing(database, module));
    return Status::Ok();
  });
}

Status CheckNotNewer(Database* database, const std::vector<Module>& modules) {
  for (const Module& module : modules) RG_RETURN_IF_ERROR(CheckApplied(database, module));
  return Status::Ok();
}

Result<std::string> PendingMigration(Database* database, const std::vector<Module>& modules) {
  RG_ASSIGN_OR_RETURN(const bool has_table, HasSchemaTable(database));
  std::string pending;
  for (const Module& module : modules) {
    if (!has_table) break;
    RG_ASSIGN_OR_RETURN(const int installed, database->ModuleVersion(module.name));
    const auto known = static_cast<int>(module.migrations.size());
    if (installed == 0 || installed >= known) continue;
    pending += (pending.empty() ? "" : "-") + module.name + "-" + std::to_string(known);
  }
  return pending;
}

Status CheckSchema(Database* database, const std::vector<Module>& modules) {
  for (const Module& module : modules) CheckModuleIsWellFormed(module);
  RG_RETURN_IF_ERROR(CheckIsOurs(database));
  RG_ASSIGN_OR_RETURN(const bool has_table, HasSchemaTable(database));
  if (!has_table) return FailedPreconditionError(database->path() + ": an empty database");
  for (const Module& module : modules) {
    RG_RETURN_IF_ERROR(CheckApplied(database, module));
    RG_ASSIGN_OR_RETURN(const int installed, database->ModuleVersion(module.name));
    if (installed < static_cast<int>(module.migrations.size()))
      return FailedPreconditionError(database->path() + ": module " + module.name + " has schema " +
                                     std::to_string(installed) + ", this program needs " +
                                     std::to_string(module.migrations.size()) +
                                     ": open it for writing once, which migrates it");
  }
  return Status::Ok();
}

}  // namespace rg::store
