// The column of Recording::other that says when a row's command was sent [s, as the column time]: a controller
// needs a while to answer the state that a row holds, and until then the command before is in force.
#pragma once

namespace rg::recordings {

inline constexpr const char* kCommandTime = "command_time";

}  // namespace rg::recordings
