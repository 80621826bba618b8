#include "services/cli/interrupt.h"

#include <csignal>

namespace rg::cli {
namespace {

CancelToken on_interrupt;

void CancelOnSignal(int) { on_interrupt.Cancel(); }

}  // namespace

CancelToken& CancelledByInterrupt() {
  for (const int number : {SIGINT, SIGTERM}) std::signal(number, CancelOnSignal);
  return on_interrupt;
}

}  // namespace rg::cli
