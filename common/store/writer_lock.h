// One writing process per database, whatever name leads to it: an flock on the database's own file. The operating
// system lets go of it when the process ends, however it ends.
#pragma once

#include <string>

#include "common/base/status.h"

namespace rg::store {

class WriterLock {
 public:
  // Makes the file, empty, where there is none. Waits up to wait_ms. kUnavailable names the process that holds it;
  // kFailedPrecondition: the file has several names of its own (hard links).
  static Result<WriterLock> Acquire(const std::string& database_path, int wait_ms);
  WriterLock() = default;
  WriterLock(WriterLock&& other) noexcept;
  WriterLock& operator=(WriterLock&& other) noexcept;
  ~WriterLock();

  struct File;

 private:
  explicit WriterLock(File* file);
  File* file_ = nullptr;
  int owner_ = 0;  // process
};

}  // namespace rg::store
