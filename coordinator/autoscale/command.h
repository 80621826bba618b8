// Another program run to its end, or to the end of our patience.
#pragma once

#include <string>
#include <vector>

#include "common/base/status.h"

namespace rg::coordinator::autoscale {

struct CommandResult {
  int code = -1;
  std::string out, err;
};

// Found by PATH, not through a shell; gets `input` (at most 64 KiB). kDeadlineExceeded: it was killed after
// `timeout_s`, and what it did is not known; kUnavailable: it could not be started.
Result<CommandResult> RunCommand(const std::vector<std::string>& words, const std::string& input,
                                 double timeout_s);

// 'it'\''s' for a POSIX shell.
std::string ShellQuoted(const std::string& word);

}  // namespace rg::coordinator::autoscale
