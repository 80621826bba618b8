// Preloaded into a program under test (LD_PRELOAD): ends it at a named point of its file work, and keeps of
// each file what was synced last, so that a kill can be made into a power cut (RestoreSynced in
// tests/support/service/cuts.h).
//
//   RG_SHIM_FOLDER=/tmp/x         only files below it; FILE.synced is the copy
//   RG_SHIM_KILL=before_sync:7    SIGKILL before the 7th sync (after_sync:7: after it, before it is reported;
//                                 before_write:7: before the 7th write)
//   RG_SHIM_KEEP=1                keep copies
#include <dlfcn.h>
#include <fcntl.h>
#include <signal.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <cstdlib>
#include <cstring>

namespace {

struct Plan {
  const char* folder = std::getenv("RG_SHIM_FOLDER");
  bool keep = std::getenv("RG_SHIM_KEEP") != nullptr;
  char point[32] = "";
  long count = 0;

  Plan() {
    const char* kill = std::getenv("RG_SHIM_KILL");
    const char* colon = kill != nullptr ? std::strchr(kill, ':') : nullptr;
    if (colon == nullptr || static_cast<size_t>(colon - kill) >= sizeof point) return;
    std::memcpy(point, kill, static_cast<size_t>(colon - kill));
    count = std::atol(colon + 1);
  }
};

const Plan& ThePlan() {
  static const Plan plan;
  return plan;
}

// The path of a file below the folder; false for any other.
bool IsOurs(int fd, char* path, size_t size) {
  const Plan& plan = ThePlan();
  if (plan.folder == nullptr) return false;
  char link[64] = "/proc/self/fd/", digits[16];
  int n = 0, value = fd;
  do digits[n++] = static_cast<char>('0' + value % 10);
  while ((value /= 10) > 0 && n < 15);
  char* end = link + std::strlen(link);
  while (n > 0) *end++ = digits[--n];
  *end = '\0';
  const ssize_t length = readlink(link, path, size - 1);
  if (length <= 0) return false;
  path[length] = '\0';
  struct stat info {};
  return std::strncmp(path, plan.folder, std::strlen(plan.folder)) == 0 && fstat(fd, &info) == 0 &&
         S_ISREG(info.st_mode);
}

void At(const char* point, std::atomic<long>* passed) {
  const Plan& plan = ThePlan();
  if (plan.count > 0 && std::strcmp(plan.point, point) == 0 && ++*passed == plan.count) raise(SIGKILL);
}

void KeepCopy(const char* path) {
  char copy[4096 + 16], whole[4096 + 16];
  if (std::strlen(path) > 4000) return;
  std::strcpy(copy, path), std::strcat(copy, ".syncing");
  std::strcpy(whole, path), std::strcat(whole, ".synced");
  const int from = open(path, O_RDONLY | O_CLOEXEC),
            to = open(copy, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
  if (from >= 0 && to >= 0) {
    char block[1 << 16];
    for (ssize_t n; (n = read(from, block, sizeof block)) > 0;) {
      for (ssize_t done = 0; done < n;) {
        using Write = ssize_t (*)(int, const void*, size_t);
        static const auto real = reinterpret_cast<Write>(dlsym(RTLD_NEXT, "write"));
        const ssize_t wrote = real(to, block + done, static_cast<size_t>(n - done));
        if (wrote <= 0) return;
        done += wrote;
      }
    }
    rename(copy, whole);
  }
  if (from >= 0) close(from);
  if (to >= 0) close(to);
}

std::atomic<long> before_syncs{0}, after_syncs{0}, before_writes{0};

int Sync(int fd, const char* name) {
  using Function = int (*)(int);
  const auto real = reinterpret_cast<Function>(dlsym(RTLD_NEXT, name));
  char path[4096];
  if (!IsOurs(fd, path, sizeof path)) return real(fd);
  At("before_sync", &before_syncs);
  const int result = real(fd);
  if (result == 0 && ThePlan().keep) KeepCopy(path);
  At("after_sync", &after_syncs);
  return result;
}

}  // namespace

extern "C" {

int fsync(int fd) { return Sync(fd, "fsync"); }
int fdatasync(int fd) { return Sync(fd, "fdatasync"); }

ssize_t pwrite64(int fd, const void* bytes, size_t size, off64_t offset) {
  using Function = ssize_t (*)(int, const void*, size_t, off64_t);
  static const auto real = reinterpret_cast<Function>(dlsym(RTLD_NEXT, "pwrite64"));
  char path[4096];
  if (ThePlan().count > 0 && IsOurs(fd, path, sizeof path)) At("before_write", &before_writes);
  return real(fd, bytes, size, offset);
}

}  // extern "C"
