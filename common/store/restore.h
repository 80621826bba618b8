// A backup becomes a database again.
#pragma once

#include <string>
#include <vector>

#include "common/base/status.h"
#include "common/store/database.h"

namespace rg::store {

struct RestoreOptions {
  std::string backup;
  std::string path;        // of the database
  bool overwrite = false;  // what is at `path` is kept as `path`.before-restore
};

// Checks the whole backup first, brings a copy of an older one to this program's tables, and puts it into its place in
// one step. `modules`: what it holds then.
// kAlreadyExists: there is a database at `path`; kUnavailable: a process writes it; kDataLoss: the backup is
// damaged; kFailedPrecondition: it is no backup of ours, or of a newer version. Then nothing has changed.
Status RestoreDatabase(const RestoreOptions& options, const std::vector<Module>& modules);

}  // namespace rg::store
