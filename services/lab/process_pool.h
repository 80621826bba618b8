// Programs run one after another, some at a time, each with its output in a log file.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "common/base/progress.h"
#include "common/base/status.h"

namespace rg::lab {

struct PooledProcess {
  std::vector<std::string> command;
  std::string log_file;
  int cpu_limit_s = 0;  // the kernel ends it when it has taken so much; 0: no limit
};

struct PooledEnd {
  int code = 0;              // 128 + signal if killed
  double cpu_s = 0;          // user and system, of the process and the children it awaited
  bool out_of_time = false;  // ended by its limit
};

// Runs all, at most `parallel` at once; `ended(index, how)` after each that was not ended by `cancel`. They
// end with this process. Cancelled: those running get SIGTERM and are awaited.
Status RunPool(const std::vector<PooledProcess>& processes, int parallel,
               const std::function<void(size_t, const PooledEnd&)>& ended, const CancelToken* cancel);

}  // namespace rg::lab
