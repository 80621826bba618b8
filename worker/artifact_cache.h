// Artefacts on the worker's disk, by hash. Bounded; what was used longest ago goes first. Several
// workers of one host may share the folder: files appear and vanish whole.
#pragma once

#include <algorithm>
#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <string_view>

#include "common/base/status.h"

namespace rg::worker {

class ArtifactCache {
 public:
  // Makes the folder and takes stock of what is in it.
  static Result<ArtifactCache> Open(const std::string& folder, uint64_t limit_bytes);

  // The file, if it is here; counts as a use.
  bool Find(const std::string& sha256, std::string* path);
  // kDataLoss if the bytes do not match the hash. Evicts others, never those that are held. The two halves of
  // it are below: what takes long, and what must be done by the cache's own thread.
  Result<std::string> Insert(const std::string& sha256, std::string_view bytes);
  // From any thread: the file is there, whole and synced, when it returns. The caller has checked the hash.
  static Status Write(const std::string& folder, const std::string& sha256, std::string_view bytes);
  // Where the file of an artefact is, or goes.
  static std::string PathIn(const std::string& folder, const std::string& sha256);
  // Such a file is part of the cache from now on.
  void Took(const std::string& sha256, uint64_t bytes);
  // Damaged or no longer wanted.
  void Remove(const std::string& sha256);
  // While a task uses it. Counted.
  void Hold(const std::string& sha256) { held_.insert(sha256); }
  void Release(const std::string& sha256);
  // Evicts as many bytes for others, as far as they are not held.
  void ShrinkBy(uint64_t bytes) { MakeRoom(bytes_ - std::min(bytes_, bytes)); }
  uint64_t bytes() const { return bytes_; }
  const std::string& folder() const { return folder_; }

 private:
  ArtifactCache(std::string folder, uint64_t limit) : folder_(std::move(folder)), limit_(limit) {}
  std::string PathOf(const std::string& sha256) const { return PathIn(folder_, sha256); }
  void Note(const std::string& sha256, uint64_t size);
  void MakeRoom(uint64_t limit);

  struct Entry {
    uint64_t size = 0;
    uint64_t last_use = 0;
  };
  std::string folder_;
  uint64_t limit_;
  uint64_t bytes_ = 0;
  uint64_t uses_ = 0;
  std::map<std::string, Entry> entries_;
  std::map<uint64_t, std::string> by_use_;
  std::multiset<std::string> held_;
};

}  // namespace rg::worker
