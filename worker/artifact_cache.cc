#include "worker/artifact_cache.h"

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <vector>

#include "common/base/file.h"
#include "common/base/hash.h"

namespace rg::worker {

namespace fs = std::filesystem;

namespace {

bool IsOld(fs::file_time_type written) {
  return fs::file_time_type::clock::now() - written > std::chrono::hours(24);
}

}  // namespace

Result<ArtifactCache> ArtifactCache::Open(const std::string& folder, uint64_t limit_bytes) {
  ArtifactCache cache(folder, limit_bytes);
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) return UnavailableError(folder + ": " + error.message());
  std::vector<std::pair<fs::file_time_type, fs::path>> files;
  for (auto it = fs::recursive_directory_iterator(folder, error); !error && it != fs::end(it);
       it.increment(error)) {
    std::error_code ignored;
    if (!it->is_regular_file(ignored)) continue;
    const std::string name = it->path().filename().string();
    if (name.size() == 64) {
      files.emplace_back(it->last_write_time(ignored), it->path());
    } else if (name.find(".part") == 64 && IsOld(it->last_write_time(ignored))) {
      fs::remove(it->path(), ignored);  // of a transfer that nobody has taken up
    }
  }
  std::sort(files.begin(), files.end());
  for (const auto& [time, path] : files) {
    const uint64_t size = fs::file_size(path, error);
    if (!error) cache.Note(path.filename().string(), size);
  }
  cache.MakeRoom(limit_bytes);
  return cache;
}

std::string ArtifactCache::PathIn(const std::string& folder, const std::string& sha256) {
  return folder + "/" + sha256.substr(0, 2) + "/" + sha256;
}

void ArtifactCache::Note(const std::string& sha256, uint64_t size) {
  Entry& entry = entries_[sha256];
  if (entry.last_use > 0) by_use_.erase(entry.last_use);
  bytes_ += size - entry.size;
  entry = {size, ++uses_};
  by_use_[entry.last_use] = sha256;
}

bool ArtifactCache::Find(const std::string& sha256, std::string* path) {
  *path = PathOf(sha256);
  std::error_code error;
  const uint64_t size = fs::file_size(*path, error);  // another worker may have put or removed it
  if (error) {
    Remove(sha256);
    return false;
  }
  Note(sha256, size);
  fs::last_write_time(*path, fs::file_time_type::clock::now(), error);
  return true;
}

Result<std::string> ArtifactCache::Insert(const std::string& sha256, std::string_view bytes) {
  if (Sha256Hex(bytes) != sha256)
    return DataLossError("artefact " + sha256 + ": the bytes do not match the hash");
  RG_RETURN_IF_ERROR(Write(folder_, sha256, bytes));
  Took(sha256, bytes.size());
  return PathOf(sha256);
}

Status ArtifactCache::Write(const std::string& folder, const std::string& sha256, std::string_view bytes) {
  return WriteFileAtomically(PathIn(folder, sha256), bytes);
}

void ArtifactCache::Took(const std::string& sha256, uint64_t bytes) {
  Note(sha256, bytes);
  Hold(sha256);
  MakeRoom(limit_);
  Release(sha256);
}

void ArtifactCache::Remove(const std::string& sha256) {
  std::error_code ignored;
  fs::remove(PathOf(sha256), ignored);
  const auto entry = entries_.find(sha256);
  if (entry == entries_.end()) return;
  bytes_ -= entry->second.size;
  by_use_.erase(entry->second.last_use);
  entries_.erase(entry);
}

void ArtifactCache::Release(const std::string& sha256) {
  const auto one = held_.find(sha256);
  if (one != held_.end()) held_.erase(one);
}

void ArtifactCache::MakeRoom(uint64_t limit) {
  std::vector<std::string> going;
  uint64_t left = bytes_;
  for (const auto& [use, sha256] : by_use_) {
    if (left <= limit) break;
    if (held_.count(sha256) > 0) continue;
    left -= entries_[sha256].size;
    going.push_back(sha256);
  }
  for (const std::string& sha256 : going) Remove(sha256);
}

}  // namespace rg::worker
