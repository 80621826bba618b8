#include "robot_agent/spool.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "common/base/file.h"
#include "common/base/log.h"
#include "common/base/printf.h"

namespace rg::robot_agent {
namespace {

namespace fs = std::filesystem;
constexpr const char* kActiveSuffix = ".rec";
constexpr const char* kReadySuffix = ".tar";
constexpr std::string_view kNotBegun = "not begun";  // in place of the time

// Oldest first; ids of the same age in their order.
std::vector<std::string> IdsByTime(const fs::path& folder, const std::string& suffix) {
  std::vector<std::pair<fs::file_time_type, std::string>> found;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder, error)) {
    if (entry.path().extension() != suffix) continue;
    std::error_code gone;
    const auto time = fs::last_write_time(entry.path(), gone);
    if (!gone) found.emplace_back(time, entry.path().stem().string());
  }
  std::sort(found.begin(), found.end());
  std::vector<std::string> ids;
  for (auto& [time, id] : found) ids.push_back(std::move(id));
  return ids;
}

// Waits for the lock by asking again: whoever has it has it for a moment.
bool TakeLock(int file, double wait_s) {
  for (double waited = 0.0;; waited += 0.02) {
    if (flock(file, LOCK_EX | LOCK_NB) == 0) return true;
    if (waited >= wait_s) return false;
    usleep(20'000);
  }
}

std::vector<std::string> IdsIn(const fs::path& folder, const std::string& suffix) {
  std::vector<std::string> ids;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder, error))
    if (entry.path().extension() == suffix) ids.push_back(entry.path().stem().string());
  std::sort(ids.begin(), ids.end());
  return ids;
}

}  // namespace

std::string DefaultSpoolFolder() {
  const char* state = std::getenv("XDG_STATE_HOME");
  const char* home = std::getenv("HOME");
  if (state != nullptr && *state == '/') return std::string(state) + "/realitygrad/spool";
  return std::string(home != nullptr ? home : "/var/tmp") + "/.local/state/realitygrad/spool";
}

Result<std::unique_ptr<Spool>> Spool::Open(const std::string& folder, double wait_s) {
  return OpenWith(folder, "lock", wait_s);
}

Result<std::unique_ptr<Spool>> Spool::OpenToDeliver(const std::string& folder) {
  return OpenWith(folder, "delivery.lock", 0.0);
}

Result<std::unique_ptr<Spool>> Spool::OpenWith(const std::string& folder, const char* lock_name,
                                               double wait_s) {
  std::error_code error;
  for (const char* part : {"active", "ready", "sent", "broken"}) {
    fs::create_directories(fs::path(folder) / part, error);
    if (error) return UnavailableError("cannot make the spool folder " + folder + ": " + error.message());
  }
  const std::string lock_path = folder + "/" + lock_name;
  const int lock = open(lock_path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (lock < 0) return UnavailableError("cannot open " + lock_path + ": " + std::strerror(errno));
  if (!TakeLock(lock, wait_s)) {
    close(lock);
    return FailedPreconditionError("another agent uses the spool folder " + folder);
  }
  return std::unique_ptr<Spool>(new Spool(folder, lock));
}

Spool::~Spool() { close(lock_); }

std::string Spool::ActivePath(const std::string& id) const {
  return folder_ + "/active/" + id + kActiveSuffix;
}
std::string Spool::ReadyPath(const std::string& id) const { return folder_ + "/ready/" + id + kReadySuffix; }
std::vector<std::string> Spool::Ready() const { return IdsIn(folder_ + "/ready", kReadySuffix); }
std::vector<std::string> Spool::Active() const { return IdsIn(folder_ + "/active", kActiveSuffix); }

Status Spool::Commit(const std::string& id, const std::string& bundle) {
  RG_RETURN_IF_ERROR(WriteFileAtomically(ReadyPath(id), bundle));
  unlink(ActivePath(id).c_str());
  return Status::Ok();
}

int Spool::Deliver(const Deliverer& deliver, double least_age_s) {
  int delivered = 0;
  const auto now = fs::file_time_type::clock::now();
  for (const std::string& id : IdsByTime(folder_ + "/ready", kReadySuffix)) {
    std::error_code gone;
    const auto written = fs::last_write_time(ReadyPath(id), gone);
    if (gone) continue;
    if (least_age_s > 0.0 && std::chrono::duration<double>(now - written).count() < least_age_s) continue;
    const auto bundle = ReadFile(ReadyPath(id));
    const Status status = bundle.ok() ? deliver(id, *bundle) : bundle.status();
    if (!status.ok() && status.code() != StatusCode::kAlreadyExists) {
      spdlog::warn("recording {} stays in the spool: {}", id, status.ToString());
      if (status.code() == StatusCode::kUnavailable) break;
      continue;
    }
    delivered += Delivered(id).ok();
  }
  return delivered;
}

Status Spool::Delivered(const std::string& id) {
  const std::string from = ReadyPath(id), to = folder_ + "/sent/" + id + kReadySuffix;
  if (rename(from.c_str(), to.c_str()) != 0 && errno != ENOENT)
    return UnavailableError("cannot move " + from + " to " + to + ": " + std::strerror(errno));
  PruneSent();
  return Status::Ok();
}

void Spool::PruneSent() const {
  const std::vector<std::string> ids = IdsByTime(folder_ + "/sent", kReadySuffix);
  for (size_t i = 0; i + kKeptSent < ids.size(); ++i)
    unlink((folder_ + "/sent/" + ids[i] + kReadySuffix).c_str());
}

std::optional<std::string> Spool::FinishedPath(const std::string& id) const {
  // Ready first, and again after sent: it may be on its way from one to the other.
  for (const std::string& path : {ReadyPath(id), folder_ + "/sent/" + id + kReadySuffix, ReadyPath(id)}) {
    std::error_code error;
    if (fs::exists(path, error)) return path;
  }
  return std::nullopt;
}

Status Spool::MarkBegun(const std::string& id, const std::string& now) {
  return AppendToBegun(id + " " + now).WithPrefix("the rollout does not begin");
}

// '+' is in no rollout's id.
Status Spool::CommitNotBegun(const std::string& id, const std::string& bundle) {
  std::string name;
  for (int attempt = 1; name.empty() || FinishedPath(name); ++attempt)
    name = id + "+not-begun-" + std::to_string(attempt);
  RG_RETURN_IF_ERROR(Commit(name, bundle));
  unlink(ActivePath(id).c_str());
  return AppendToBegun(id + " " + std::string(kNotBegun));
}

Status Spool::AppendToBegun(const std::string& text) const {
  const std::string path = folder_ + "/begun.txt";
  const int file = open(path.c_str(), O_RDWR | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
  if (file < 0) return UnavailableError("cannot open " + path + ": " + std::strerror(errno));
  // A line that a power cut tore is ended first; nothing was done on the strength of it.
  const off_t size = lseek(file, 0, SEEK_END);
  char last = '\n';
  if (size > 0 && pread(file, &last, 1, size - 1) != 1) last = ' ';
  const std::string line = (last == '\n' ? "" : "\n") + text + "\n";
  const bool kept =
      write(file, line.data(), line.size()) == static_cast<ssize_t>(line.size()) && fsync(file) == 0;
  const int error = errno;
  close(file);
  if (kept) return Status::Ok();
  return ResourceExhaustedError("cannot write " + path + ": " + std::strerror(error));
}

std::optional<std::string> Spool::Begun(const std::string& id) const {
  std::ifstream file(folder_ + "/begun.txt");
  std::optional<std::string> begun;
  for (std::string line; std::getline(file, line);) {
    if (line == id + " " + std::string(kNotBegun)) begun.reset();
    else if (line.rfind(id + " ", 0) == 0 || line == id) begun = line;
  }
  return begun;
}

Status Spool::CheckRoom(double megabytes) const {
  struct statvfs disk {};
  if (statvfs(folder_.c_str(), &disk) != 0)
    return UnavailableError("cannot look at the disk of " + folder_ + ": " + std::strerror(errno));
  const double free = 1e-6 * static_cast<double>(disk.f_bavail) * static_cast<double>(disk.f_frsize);
  if (free >= megabytes) return Status::Ok();
  const std::string text = Printf(": %.0f MB are free, a rollout needs %.0f MB; %zu recordings wait here",
                                  free, megabytes, Ready().size());
  return ResourceExhaustedError("the disk of the spool " + folder_ + text +
                                " for the coordinator: let it take them, or make room");
}

std::vector<std::string> Spool::Salvage(const Finisher& finish) {
  std::vector<std::string> salvaged;
  for (const std::string& id : Active()) {
    const auto bundle = finish(ActivePath(id));
    if (bundle.ok() && Commit(id, *bundle).ok()) {
      salvaged.push_back(id);
      continue;
    }
    if (!bundle.ok() && bundle.status().code() == StatusCode::kDataLoss) {
      spdlog::error("recording {} cannot be read, kept in {}/broken: {}", id, folder_,
                    bundle.status().ToString());
      std::error_code ignored;
      fs::rename(ActivePath(id), fs::path(folder_) / "broken" / (id + kActiveSuffix), ignored);
    } else {
      spdlog::error("recording {} could not be finished: {}", id, bundle.status().ToString());
    }
  }
  return salvaged;
}

}  // namespace rg::robot_agent
