// How long work tells where it is, and how it is told to stop.
#pragma once

#include <atomic>
#include <functional>
#include <string>

namespace rg {

// `stage` is a word or two ("trajectories"); `done` of `total` in units of the stage; `note` is what
// a person would like to know now ("loss 0.012"). Shown with an ETA by the command line, sent by
// workers as task progress.
struct ProgressUpdate {
  std::string stage;
  double done = 0.0;
  double total = 0.0;
  std::string note;
};
using ProgressFn = std::function<void(const ProgressUpdate&)>;  // may be empty: then nobody listens

// Set from any thread or from a signal handler; read often by long work, which then returns early
// with what it has and says so.
class CancelToken {
 public:
  void Cancel() { cancelled_.store(true, std::memory_order_relaxed); }
  bool cancelled() const { return cancelled_.load(std::memory_order_relaxed); }

 private:
  std::atomic<bool> cancelled_{false};
};

}  // namespace rg
