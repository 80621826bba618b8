#include "worker/scratch_space.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstring>
#include <filesystem>
#include <utility>

namespace rg::worker {

namespace fs = std::filesystem;

namespace {

constexpr char kLock[] = ".lock";

int OpenLock(const std::string& path, int flags) {
  return ::open(path.c_str(), O_RDWR | O_CLOEXEC | flags, 0600);
}

// False if a living process has it.
bool TakeLock(int lock) { return ::flock(lock, LOCK_EX | LOCK_NB) == 0; }

// Somebody who swept may have removed it between our open and our lock.
bool IsStillThere(int lock) {
  struct stat status {};
  return ::fstat(lock, &status) == 0 && status.st_nlink > 0;
}

void RemoveIfDead(const std::string& lock_path) {
  const int lock = OpenLock(lock_path, 0);
  if (lock < 0) return;
  std::error_code ignored;
  if (TakeLock(lock)) {
    fs::remove_all(lock_path.substr(0, lock_path.size() - (sizeof kLock - 1)), ignored);
    fs::remove(lock_path, ignored);
  }
  ::close(lock);
}

// Of a process that knew no locks.
void RemoveIfOld(const fs::path& space) {
  constexpr auto kOld = std::chrono::hours(24 * 7);
  std::error_code error;
  const auto written = fs::last_write_time(space, error);
  if (error || fs::exists(space.string() + kLock, error)) return;
  if (fs::file_time_type::clock::now() - written > kOld) fs::remove_all(space, error);
}

void Sweep(const std::string& folder) {
  std::error_code error;
  for (auto it = fs::directory_iterator(folder, error); !error && it != fs::end(it); it.increment(error)) {
    std::error_code ignored;
    if (it->path().extension() == kLock) {
      RemoveIfDead(it->path().string());
    } else if (it->is_directory(ignored)) {
      RemoveIfOld(it->path());
    }
  }
}

}  // namespace

Result<ScratchSpace> ScratchSpace::Open(const std::string& folder, const std::string& instance) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) return UnavailableError(folder + ": " + error.message());
  Sweep(folder);
  const std::string path = folder + "/" + instance;
  constexpr int kTries = 10;
  for (int i = 0; i < kTries; ++i) {
    const int lock = OpenLock(path + kLock, O_CREAT);
    if (lock < 0) return UnavailableError(path + kLock + ": " + std::strerror(errno));
    if (TakeLock(lock) && IsStillThere(lock)) return ScratchSpace(path, lock);
    ::close(lock);
  }
  return UnavailableError(path + ": another process has it");
}

ScratchSpace::ScratchSpace(ScratchSpace&& other) noexcept
    : path_(std::move(other.path_)), lock_(std::exchange(other.lock_, -1)) {}

ScratchSpace::~ScratchSpace() {
  if (lock_ < 0) return;
  std::error_code ignored;
  fs::remove_all(path_, ignored);
  fs::remove(path_ + kLock, ignored);
  ::close(lock_);
}

}  // namespace rg::worker
