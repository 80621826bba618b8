// Copies of the database, made at intervals while it is in use, in the folder `backups` beside it: STEM-20260301T083000Z.db.
// Each is checked after it was written and counts only then; the newest few stay. When the last one was made is seen
// from the folder, so that a restart changes nothing. In a thread of its own, on a connection of its own.
#pragma once

#include <condition_variable>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "common/base/status.h"

namespace rg::coordinator {

struct BackupOptions {
  std::string database;
  double every_s = 0.0;  // 0: none is made
  int keep = 14;
};

// "90s", "15m", "36h", "7d"; empty or "0": 0.
Result<double> ParseInterval(const std::string& text);

class ScheduledBackups {
 public:
  explicit ScheduledBackups(const BackupOptions& options);
  ~ScheduledBackups();  // one under way is finished

  // Makes one now and removes those that are too many; the path of it.
  static Result<std::string> MakeOne(const BackupOptions& options, int64_t wall_ns);
  // Paths, the oldest first.
  static std::vector<std::string> List(const BackupOptions& options);

 private:
  void Work();
  const BackupOptions options_;
  std::mutex mutex_;
  std::condition_variable wake_;
  bool stop_ = false;
  std::thread thread_;
};

}  // namespace rg::coordinator
