// Ctrl-C in commands that work in this process.
#pragma once

#include <condition_variable>
#include <csignal>
#include <functional>
#include <initializer_list>
#include <mutex>
#include <string>
#include <thread>

#include "common/base/progress.h"

namespace rg::cli {

// Cancelled by these signals from the first call on; a second signal ends the process at once. What has no answer when it
// is ended early leaves SIGTERM as it is, and its callers find nothing.
CancelToken& CancelledByInterrupt(std::initializer_list<int> signals = {SIGINT});

// While it lives, Ctrl-C ends the process with kExitCancelled wherever its work is, with what `on_stop` says. That runs
// in a thread of its own, and is not waited for longer than half a second.
class EndsOnInterrupt {
 public:
  explicit EndsOnInterrupt(std::function<std::string()> on_stop);
  // Does not return where a Ctrl-C came before.
  ~EndsOnInterrupt();

 private:
  void Watch();

  const CancelToken& interrupted_;
  std::function<std::string()> on_stop_;
  std::mutex mutex_;
  std::condition_variable wake_;
  bool end_ = false;
  std::thread watcher_;
};

}  // namespace rg::cli
