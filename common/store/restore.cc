#include "common/store/restore.h"

#include <filesystem>

#include "common/base/ids.h"
#include "common/store/writer_lock.h"

namespace rg::store {
namespace {

namespace fs = std::filesystem;

// The database with what belongs to it: an old log beside a new file would be played into it.
Status MoveAside(const std::string& path) {
  const std::string kept = path + ".before-restore";
  if (fs::exists(kept)) return AlreadyExistsError(kept + ": is there already, from an earlier restore");
  std::error_code error;
  for (const char* suffix : {"-wal", "-shm", ""}) {
    if (!fs::exists(path + suffix)) continue;
    fs::rename(path + suffix, kept + suffix, error);
    if (error) return InternalError(path + suffix + ": cannot be moved: " + error.message());
  }
  return Status::Ok();
}

}  // namespace

Status RestoreDatabase(const RestoreOptions& options, const std::vector<Module>& modules) {
  DatabaseOptions from;
  from.path = options.backup;
  from.read_only = true;
  RG_ASSIGN_OR_RETURN(const auto backup, Database::Open(from, modules));
  RG_RETURN_IF_ERROR(backup->CheckIntegrity());
  std::error_code error;
  if (fs::equivalent(options.backup, options.path, error))
    return InvalidError(options.backup + ": is the database itself, not a backup of it");
  if (fs::exists(options.path) && !options.overwrite)
    return AlreadyExistsError(options.path + ": there is a database already; --overwrite moves it aside");
  const fs::path folder = fs::path(options.path).parent_path();
  if (!folder.empty()) fs::create_directories(folder, error);
  RG_ASSIGN_OR_RETURN(const WriterLock lock, WriterLock::Acquire(options.path, 0));
  const std::string copy = options.path + ".restoring." + RandomHex(4);
  Status done = backup->BackupTo(copy);
  if (done.ok() && fs::exists(options.path)) done = MoveAside(options.path);
  if (done.ok()) {
    fs::rename(copy, options.path, error);
    if (error) done = InternalError(options.path + ": cannot be put there: " + error.message());
  }
  if (!done.ok()) fs::remove(copy, error);
  return done;
}

}  // namespace rg::store
