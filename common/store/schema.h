// The version table and the migrations: which schema a database file has, and how it gets to the
// one this program knows. Internal to Database::Open.
#pragma once

#include <string>
#include <vector>

#include "common/base/status.h"
#include "common/store/database.h"

namespace rg::store {

// Written into the file's header ("RGdb"). Frozen.
inline constexpr int kApplicationId = 0x52476462;

// Of the database itself, beside those of its user: which database it is.
const Module& OwnModule();

// Refuses a file that is no database of this project, a module newer than the program, and a
// migration that was edited after it was applied; then applies what is missing, all or nothing.
Status MigrateAll(Database* database, const std::vector<Module>& modules);
// What is older in the file than the program knows it: "coordinator-4" for a step to that version; empty:
// nothing is, or it is no database of this project yet.
Result<std::string> PendingMigration(Database* database, const std::vector<Module>& modules);
// kFailedPrecondition: the file has a module that is newer than here, or not the one that is here.
Status CheckNotNewer(Database* database, const std::vector<Module>& modules);
// Random, of 32 hexadecimal digits. A copy has none: it is given one where somebody writes to it (`mint`).
Result<std::string> IdentityOf(Database* database, bool mint);
// The checks only, for readers: every module must be there at the version of the program.
Status CheckSchema(Database* database, const std::vector<Module>& modules);

}  // namespace rg::store
