// realitygrad agent status | watch | arm | disarm | stop | clear: words to the agent on this machine, through
// its local socket. Parsing, asking, and what a person sees.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "common/base/status.h"

namespace rg::robot_agent {

// Exit code if arguments[1] is one of the words above; else nothing: then it is the agent's own program.
std::optional<int> RunAgentCommand(const std::vector<std::string>& arguments);

// The answer to "status" (see supervisor.h) as lines of text: joints against their limits as bars.
std::string StatusText(const std::string& status_json);

}  // namespace rg::robot_agent
