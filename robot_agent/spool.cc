#include "robot_agent/spool.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>

#include "common/base/file.h"
#include "common/base/log.h"

namespace rg::robot_agent {
namespace {

namespace fs = std::filesystem;
constexpr const char* kActiveSuffix = ".rec";
constexpr const char* kReadySuffix = ".tar";

std::vector<std::string> IdsIn(const fs::path& folder, const std::string& suffix) {
  std::vector<std::string> ids;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder, error))
    if (entry.path().extension() == suffix) ids.push_back(entry.path().stem().string());
  std::sort(ids.begin(), ids.end());
  return ids;
}

}  // namespace

Result<std::unique_ptr<Spool>> Spool::Open(const std::string& folder) {
  std::error_code error;
  for (const char* part : {"active", "ready", "broken"}) {
    fs::create_directories(fs::path(folder) / part, error);
    if (error) return UnavailableError("cannot make the spool folder " + folder + ": " + error.message());
  }
  const std::string lock_path = folder + "/lock";
  const int lock = open(lock_path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (lock < 0) return UnavailableError("cannot open " + lock_path + ": " + std::strerror(errno));
  if (flock(lock, LOCK_EX | LOCK_NB) != 0) {
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

int Spool::Deliver(const Deliverer& deliver) {
  int delivered = 0;
  for (const std::string& id : Ready()) {
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
  const std::string path = ReadyPath(id);
  if (unlink(path.c_str()) == 0 || errno == ENOENT) return Status::Ok();
  return UnavailableError("cannot remove " + path + ": " + std::strerror(errno));
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
