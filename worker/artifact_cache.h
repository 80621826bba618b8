// Artefacts on the worker's disk, by hash. Bounded; what was used longest ago goes first. Several
// workers of one host may share the folder: files appear and vanish whole.
#pragma once

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
  // kDataLoss if the bytes do not match the hash. Evicts others, never those that are held.
  Result<std::string> Insert(const std::string& sha256, std::string_view bytes);
  // Damaged or no longer wanted.
  void Remove(const std::string& sha256);
  // While a task uses it. Counted.
  void Hold(const std::string& sha256) { held_.insert(sha256); }
  void Release(const std::string& sha256);
  uint64_t bytes() const { return bytes_; }

 private:
  ArtifactCache(std::string folder, uint64_t limit) : folder_(std::move(folder)), limit_(limit) {}
  std::string PathOf(const std::string& sha256) const;
  void Note(const std::string& sha256, uint64_t size);
  void MakeRoom();

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
