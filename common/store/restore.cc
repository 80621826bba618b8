#include "common/store/restore.h"

#include <fcntl.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>

#include "common/base/ids.h"
#include "common/store/schema.h"
#include "common/store/writer_lock.h"

namespace rg::store {
namespace {

namespace fs = std::filesystem;

// What the name leads to, there or not: not a link is moved aside, but the database.
fs::path Followed(fs::path path) {
  constexpr int kMostLinks = 40;
  std::error_code error;
  for (int i = 0; i < kMostLinks && fs::is_symlink(path, error); ++i)
    path = path.parent_path() / fs::read_symlink(path, error);
  return path;
}

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

// Never in the place of a database that somebody has made there meanwhile.
Status PutThere(const std::string& copy, const std::string& path) {
  if (::renameat2(AT_FDCWD, copy.c_str(), AT_FDCWD, path.c_str(), RENAME_NOREPLACE) == 0) return Status::Ok();
  const std::string why = std::strerror(errno);
  return errno == EEXIST ? AlreadyExistsError(path + ": somebody has just made a database there")
                         : InternalError(path + ": cannot be put there: " + why);
}

}  // namespace

Status RestoreDatabase(const RestoreOptions& options, const std::vector<Module>& modules) {
  DatabaseOptions from;
  from.path = options.backup;
  from.read_only = true;
  RG_ASSIGN_OR_RETURN(const auto backup, Database::Open(from, {}));
  RG_RETURN_IF_ERROR(CheckNotNewer(backup.get(), modules));
  RG_RETURN_IF_ERROR(backup->CheckIntegrity());
  std::error_code error;
  if (fs::equivalent(options.backup, options.path, error))
    return InvalidError(options.backup + ": is the database itself, not a backup of it");
  const std::string path = Followed(options.path).string();
  const bool is_there = fs::exists(path);
  if (is_there && !options.overwrite)
    return AlreadyExistsError(options.path + ": there is a database already; --overwrite moves it aside");
  const fs::path folder = fs::path(path).parent_path();
  if (!folder.empty()) fs::create_directories(folder, error);
  WriterLock lock;
  if (is_there) {
    RG_ASSIGN_OR_RETURN(lock, WriterLock::Acquire(path, 0));
  }
  const std::string copy = path + ".restoring." + RandomHex(4);
  Status done = backup->BackupTo(copy);
  if (done.ok()) done = Database::Open({.path = copy, .copy_first = false}, modules).status();  // of this version
  if (done.ok() && is_there) done = MoveAside(path);
  if (done.ok()) done = PutThere(copy, path);
  if (!done.ok()) fs::remove(copy, error);
  return done;
}

}  // namespace rg::store
