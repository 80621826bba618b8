// MCAP files (mcap.dev/spec), read from front to back: chunks (none, lz4, zstd) or none, indexed or not.
//
// Errors name the source and the byte; a file that ends within a record is read up to there, with a note.
// A chunk's CRC is checked where it is given.
#pragma once

#include <string>
#include <string_view>

#include "services/importing/log.h"

namespace rg::importing {

bool LooksLikeMcap(std::string_view bytes);
Status ReadMcap(std::string_view bytes, const std::string& source_name, LogSink& sink,
                const ReadLimits& limits = {});

}  // namespace rg::importing
