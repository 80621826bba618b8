// Kills at named points and power cuts of a coordinator that runs under tests/support/sync_shim.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <string>

#include "common/base/file.h"
#include "tests/support/service/processes.h"

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define RG_NEEDS_PRELOADING() \
  GTEST_SKIP() << "ALL: a sanitizer's runtime does not go with a preloaded library"
#else
#define RG_NEEDS_PRELOADING() static_cast<void>(0)
#endif

namespace rg::testing {

// While this lives, programs that are started run under the shim. `kill`: "before_sync:7"; empty: no point.
class UnderShim {
 public:
  UnderShim(const std::string& folder, const std::string& kill, bool keep_synced) {
    setenv("LD_PRELOAD", (BinFolder() + "/librg_sync_shim.so").c_str(), 1);
    setenv("RG_SHIM_FOLDER", folder.c_str(), 1);
    if (!kill.empty()) setenv("RG_SHIM_KILL", kill.c_str(), 1);
    if (keep_synced) setenv("RG_SHIM_KEEP", "1", 1);
  }
  ~UnderShim() {
    for (const char* name : {"LD_PRELOAD", "RG_SHIM_FOLDER", "RG_SHIM_KILL", "RG_SHIM_KEEP"}) unsetenv(name);
  }
  UnderShim(const UnderShim&) = delete;
};

// How many of the longer one's bytes are other in the shorter one, or not there.
inline int64_t DifferentBytes(const std::string& a, const std::string& b) {
  const std::string x = ReadFile(a).value(), y = ReadFile(b).value();
  int64_t different = static_cast<int64_t>(std::max(x.size(), y.size()) - std::min(x.size(), y.size()));
  for (size_t i = 0; i < std::min(x.size(), y.size()); ++i) different += x[i] != y[i];
  return different;
}

// The database as a machine finds it that lost power: what was never synced is gone. The program that had it
// open must be dead. How many bytes of its files were lost.
inline int64_t RestoreSynced(const std::string& database) {
  namespace fs = std::filesystem;
  int64_t lost = 0;
  for (const std::string& file : {database, database + "-wal"}) {
    if (!fs::exists(file + ".synced")) {
      fs::remove(file);
    } else {
      if (fs::exists(file)) lost += DifferentBytes(file, file + ".synced");
      fs::copy_file(file + ".synced", file, fs::copy_options::overwrite_existing);
    }
  }
  fs::remove(database + "-shm");
  return lost;
}

}  // namespace rg::testing
