// One writing process per database: an flock on "<database>.lock", which also says who holds it.
// The operating system lets go of it when the process ends, however it ends.
#pragma once

#include <string>

#include "common/base/status.h"

namespace rg::store {

class WriterLock {
 public:
  // Waits up to wait_ms. kUnavailable names the process that holds it.
  static Result<WriterLock> Acquire(const std::string& database_path, int wait_ms);
  WriterLock() = default;
  WriterLock(WriterLock&& other) noexcept;
  WriterLock& operator=(WriterLock&& other) noexcept;
  ~WriterLock();

 private:
  explicit WriterLock(int fd);
  int fd_ = -1;
  int owner_ = 0;  // process
};

}  // namespace rg::store
