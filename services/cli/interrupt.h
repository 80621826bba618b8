// Ctrl-C in commands that work in this process.
#pragma once

#include <csignal>
#include <initializer_list>

#include "common/base/progress.h"

namespace rg::cli {

// Cancelled by these signals from the first call on. What has no answer when it is ended early leaves SIGTERM
// as it is, and its callers find nothing.
CancelToken& CancelledByInterrupt(std::initializer_list<int> signals = {SIGINT});

}  // namespace rg::cli
