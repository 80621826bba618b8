#include "services/cli/interrupt.h"

#include <unistd.h>

#include <chrono>
#include <future>

#include "services/cli/output.h"
#include "services/cli/progress_display.h"

namespace rg::cli {
namespace {

constexpr auto kLook = std::chrono::milliseconds(20);
constexpr auto kPatience = std::chrono::milliseconds(500);

CancelToken on_interrupt;

void CancelOnSignal(int number) {
  if (on_interrupt.cancelled()) {
    std::signal(number, SIG_DFL);
    std::raise(number);
  }
  on_interrupt.Cancel();
}

}  // namespace

CancelToken& CancelledByInterrupt(std::initializer_list<int> signals) {
  for (const int number : signals) std::signal(number, CancelOnSignal);
  return on_interrupt;
}

EndsOnInterrupt::EndsOnInterrupt(std::function<std::string()> on_stop)
    : interrupted_(CancelledByInterrupt()), on_stop_(std::move(on_stop)), watcher_([this] { Watch(); }) {}

EndsOnInterrupt::~EndsOnInterrupt() {
  {
    const std::lock_guard lock(mutex_);
    end_ = true;
  }
  wake_.notify_all();
  watcher_.join();
}

void EndsOnInterrupt::Watch() {
  std::unique_lock lock(mutex_);
  while (!interrupted_.cancelled() && !end_) wake_.wait_for(lock, kLook);
  if (!interrupted_.cancelled()) return;
  std::packaged_task<std::string()> stop(on_stop_);
  auto said = stop.get_future();
  std::thread(std::move(stop)).detach();
  const std::string what = said.wait_for(kPatience) == std::future_status::ready ? said.get() : "";
  PrintNote((StderrIsTerminal() ? "\nstopped by Ctrl-C" : "stopped by Ctrl-C") + what);
  _exit(kExitCancelled);
}

}  // namespace rg::cli
