// Programs run one after another, some at a time, each with its output in a log file.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "common/base/progress.h"
#include "common/base/status.h"

namespace rg::cli {

struct PooledProcess {
  std::vector<std::string> command;
  std::string log_file;
};

// Runs all, at most `parallel` at once; `ended(index, exit code)` after each (128 + signal if killed). They
// end with this process. Cancelled: those running get SIGTERM and are awaited.
Status RunPool(const std::vector<PooledProcess>& processes, int parallel,
               const std::function<void(size_t, int)>& ended, const CancelToken* cancel);

}  // namespace rg::cli
