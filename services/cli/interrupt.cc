#include "services/cli/interrupt.h"

namespace rg::cli {
namespace {

CancelToken on_interrupt;

void CancelOnSignal(int) { on_interrupt.Cancel(); }

}  // namespace

CancelToken& CancelledByInterrupt(std::initializer_list<int> signals) {
  for (const int number : signals) std::signal(number, CancelOnSignal);
  return on_interrupt;
}

}  // namespace rg::cli
