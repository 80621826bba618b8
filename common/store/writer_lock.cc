#include "common/store/writer_lock.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <chrono>
#include <cinttypes>
#include <cstdio>
#include <cstring>
#include <deque>
#include <fstream>
#include <mutex>
#include <thread>
#include <utility>

namespace rg::store {

// Its descriptor stays open for good: whoever closes one lets go of all locks that SQLite has on the file in this
// process, which are POSIX locks.
struct WriterLock::File {
  const int fd;
  const dev_t device;
  const ino_t number;
  std::atomic<bool> held{false};
};

namespace {

bool IsAt(const std::string& path, const WriterLock::File& file, struct stat* found) {
  return ::stat(path.c_str(), found) == 0 && found->st_dev == file.device && found->st_ino == file.number;
}

// The files that this process has had locked.
struct Known {
  std::mutex mutex;
  std::deque<WriterLock::File> files;
  pid_t owner = ::getpid();
};

Result<WriterLock::File*> FindFile(const std::string& path) {
  static Known known;
  const std::lock_guard lock(known.mutex);
  if (std::exchange(known.owner, ::getpid()) != ::getpid()) known.files.clear();  // forked: those are the parent's
  struct stat found = {};
  for (WriterLock::File& file : known.files) {
    if (IsAt(path, file, &found)) return &file;
  }
  const int fd = ::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (fd < 0 || ::fstat(fd, &found) != 0) {
    const StatusCode code = errno == EACCES || errno == EROFS ? StatusCode::kPermissionDenied
                            : errno == ENOSPC                 ? StatusCode::kResourceExhausted
                                                              : StatusCode::kInternal;
    return Status(code, path + ": cannot open: " + std::strerror(errno));
  }
  return &known.files.emplace_back(fd, found.st_dev, found.st_ino);
}

// False: somebody has it.
Result<bool> Take(WriterLock::File* file) {
  if (file->held.exchange(true)) return false;
  if (::flock(file->fd, LOCK_EX | LOCK_NB) == 0) return true;
  const int error = errno;
  file->held = false;
  if (error == EWOULDBLOCK || error == EINTR) return false;
  return InternalError(std::string("cannot lock: ") + std::strerror(error));
}

// As the system lists it.
std::string HolderOf(const WriterLock::File& file) {
  if (file.held) return "process " + std::to_string(::getpid());
  std::ifstream locks("/proc/locks");
  for (std::string line; std::getline(locks, line);) {
    int pid = 0;
    unsigned of_device = 0, in_device = 0;
    uint64_t number = 0;
    const int fields = std::sscanf(line.c_str(), "%*d: FLOCK ADVISORY WRITE %d %x:%x:%" SCNu64, &pid, &of_device,
                                   &in_device, &number);
    if (fields == 4 && pid > 0 && number == file.number && makedev(of_device, in_device) == file.device)
      return "process " + std::to_string(pid);
  }
  return "another process";
}

// SQLite keeps what was written last in a file beside the name that it was opened by.
Status CheckOneName(const std::string& path, nlink_t names) {
  if (names <= 1) return Status::Ok();
  return FailedPreconditionError(path + ": the file has " + std::to_string(names) +
                                 " names (hard links), and a database may have one only: remove the others, or "
                                 "work on a copy");
}

}  // namespace

Result<WriterLock> WriterLock::Acquire(const std::string& path, int wait_ms) {
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::milliseconds(wait_ms);
  while (true) {
    RG_ASSIGN_OR_RETURN(File* const file, FindFile(path));
    const auto taken = Take(file);
    if (!taken.ok()) return taken.status().WithPrefix(path);
    WriterLock lock(*taken ? file : nullptr);
    struct stat found = {};
    if (*taken && IsAt(path, *file, &found)) {  // else another one was put into its place meanwhile
      RG_RETURN_IF_ERROR(CheckOneName(path, found.st_nlink));
      return lock;
    }
    if (!*taken && std::chrono::steady_clock::now() >= deadline)
      return UnavailableError(path + ": in use by " + HolderOf(*file) +
                              ", and only one process may write to a database");
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
}

WriterLock::WriterLock(File* file) : file_(file), owner_(::getpid()) {}

WriterLock::WriterLock(WriterLock&& other) noexcept
    : file_(std::exchange(other.file_, nullptr)), owner_(other.owner_) {}

WriterLock& WriterLock::operator=(WriterLock&& other) noexcept {
  std::swap(file_, other.file_);
  std::swap(owner_, other.owner_);
  return *this;
}

WriterLock::~WriterLock() {
  if (file_ == nullptr || owner_ != ::getpid()) return;  // a forked child must not end its parent's
  ::flock(file_->fd, LOCK_UN);
  file_->held = false;
}

}  // namespace rg::store
