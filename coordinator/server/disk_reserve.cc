#include "coordinator/server/disk_reserve.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

namespace rg::coordinator {

Status DiskReserve::Keep() {
  struct stat there = {};
  if (path_.empty() || (::stat(path_.c_str(), &there) == 0 && there.st_blocks * 512 >= bytes_)) return Status::Ok();
  const int file = ::open(path_.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0600);
  if (file < 0) return ResourceExhaustedError(path_ + ": " + std::strerror(errno));
  const int error = ::posix_fallocate(file, 0, bytes_);
  ::close(file);
  if (error == 0) return Status::Ok();
  GiveUp();
  return ResourceExhaustedError(path_ + ": " + std::strerror(error));
}

void DiskReserve::GiveUp() {
  if (!path_.empty()) ::unlink(path_.c_str());
}

}  // namespace rg::coordinator
