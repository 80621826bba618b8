#include "common/store/writer_lock.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstring>
#include <thread>
#include <utility>

namespace rg::store {
namespace {

std::string HolderOf(int fd) {
  char text[64] = {};
  const ssize_t n = ::pread(fd, text, sizeof text - 1, 0);
  std::string holder(text, n > 0 ? static_cast<size_t>(n) : 0);
  while (!holder.empty() && holder.back() == '\n') holder.pop_back();
  return holder.empty() ? "another process" : holder;
}

void NoteHolder(int fd) {
  const std::string holder = "process " + std::to_string(::getpid()) + "\n";
  // Only for a person's eyes: a failure (disk full) changes nothing of the lock.
  if (::ftruncate(fd, 0) == 0) [[maybe_unused]]
    const ssize_t n = ::pwrite(fd, holder.data(), holder.size(), 0);
}

}  // namespace

Result<WriterLock> WriterLock::Acquire(const std::string& database_path, int wait_ms) {
  const std::string path = database_path + ".lock";
  const int fd = ::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (fd < 0) {
    const StatusCode code = errno == EACCES || errno == EROFS ? StatusCode::kPermissionDenied
                            : errno == ENOSPC                 ? StatusCode::kResourceExhausted
                                                              : StatusCode::kInternal;
    return Status(code, path + ": cannot open: " + std::strerror(errno));
  }
  WriterLock lock(fd);
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::milliseconds(wait_ms);
  while (::flock(fd, LOCK_EX | LOCK_NB) != 0) {
    if (errno != EWOULDBLOCK && errno != EINTR)
      return InternalError(path + ": cannot lock: " + std::strerror(errno));
    if (std::chrono::steady_clock::now() >= deadline)
      return UnavailableError(database_path + ": in use by " + HolderOf(fd) +
                              ", and only one process may write to a database");
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  NoteHolder(fd);
  return lock;
}

WriterLock::WriterLock(int fd) : fd_(fd), owner_(::getpid()) {}

WriterLock::WriterLock(WriterLock&& other) noexcept
    : fd_(std::exchange(other.fd_, -1)), owner_(other.owner_) {}

WriterLock& WriterLock::operator=(WriterLock&& other) noexcept {
  std::swap(fd_, other.fd_);
  std::swap(owner_, other.owner_);
  return *this;
}

WriterLock::~WriterLock() {
  if (fd_ < 0) return;
  // A forked child shares the lock: it must not end ours, and its copy must not outlive our closing.
  if (owner_ == ::getpid()) ::flock(fd_, LOCK_UN);
  ::close(fd_);
}

}  // namespace rg::store
