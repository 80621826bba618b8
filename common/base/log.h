// Logging: spdlog on stderr, one line per event, ISO 8601 UTC. Data goes to stdout, never here.
#pragma once

#include <spdlog/spdlog.h>

#include <string>

namespace rg {

// Call once at the start of a program. `program` is shown in each line; level from `level`
// ("debug", "info", "warn", "error") or, if empty, from RG_LOG, or "info".
void InitLogging(const std::string& program, const std::string& level = "");

}  // namespace rg
