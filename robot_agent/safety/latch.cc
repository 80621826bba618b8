#include "robot_agent/safety/latch.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/base/file.h"

namespace rg::robot_agent {
namespace {

using nlohmann::json;

constexpr char kUnderWay[] = "under_way", kLatched[] = "latched";

void SyncFolderOf(const std::string& path) {
  const std::string folder = std::filesystem::path(path).parent_path().string();
  const int file = open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (file < 0) return;
  (void)fsync(file);
  close(file);
}

}  // namespace

Latch::Latch(const std::string& folder) : path_(folder + "/latch.json") {}

std::optional<LatchEntry> Latch::Read() const {
  std::error_code error;
  const bool there = std::filesystem::exists(path_, error);
  if (!there && !error) return std::nullopt;
  LatchEntry entry;
  entry.reason = path_ + " cannot be read";
  const auto text = ReadFile(path_);
  if (!text.ok()) return entry;
  const json root = json::parse(*text, nullptr, false);
  if (!root.is_object()) return entry;
  const auto field = [&](const char* name) {
    return root.contains(name) && root[name].is_string() ? root[name].get<std::string>() : std::string();
  };
  entry.latched = field("state") != kUnderWay;
  entry.rollout = field("rollout");
  entry.reason = field("reason");
  entry.since = field("since");
  return entry;
}

Status Latch::CheckClear() const {
  const auto entry = Read();
  if (!entry) return Status::Ok();
  const std::string what = entry->latched ? "the last stop was not confirmed (" + entry->reason + ")"
                                          : "whoever moved the arm was lost before the stop was confirmed";
  return FailedPreconditionError("latched since " + entry->since + ", rollout " + entry->rollout + ": " +
                                 what + "; look at the arm, then: realitygrad agent clear");
}

Status Latch::Write(const LatchEntry& entry) const {
  return WriteFileAtomically(path_, json{{"state", entry.latched ? kLatched : kUnderWay},
                                         {"rollout", entry.rollout},
                                         {"reason", entry.reason},
                                         {"since", entry.since}}
                                            .dump() +
                                        "\n");
}

Status Latch::BeginMotion(const std::string& rollout, const std::string& now) {
  RG_RETURN_IF_ERROR(CheckClear());
  return Write({.latched = false, .rollout = rollout, .reason = "the arm is moved", .since = now});
}

Status Latch::EndMotion() { return Clear(); }

Status Latch::Set(const std::string& rollout, const std::string& reason, const std::string& now) {
  Status written;
  for (int attempt = 0; attempt < 3; ++attempt) {
    written = Write({.latched = true, .rollout = rollout, .reason = reason, .since = now});
    if (written.ok()) break;
  }
  return written;
}

Status Latch::Clear() {
  if (unlink(path_.c_str()) != 0 && errno != ENOENT)
    return UnavailableError("cannot remove " + path_ + ": " + std::strerror(errno));
  SyncFolderOf(path_);
  return Status::Ok();
}

}  // namespace rg::robot_agent
