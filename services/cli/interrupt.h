// Ctrl-C in commands that work in this process.
#pragma once

#include "common/base/progress.h"

namespace rg::cli {

// Cancelled by SIGINT or SIGTERM from the first call on.
CancelToken& CancelledByInterrupt();

}  // namespace rg::cli
